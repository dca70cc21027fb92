"""Simulated gamepad: JavaScript that replaces the browser's gamepad interface."""

#: Function that sets the state of the gamepad; null disconnects the gamepad. With `obeys` the simulated user releases
#: the button when the page requests the release.
PAD = """(pad) => { navigator.getGamepads = () => [pad === null ? null : {
  index: 0, id: "Test Pad (STANDARD GAMEPAD Vendor: 0000)", mapping: "standard", connected: true, axes: pad.axes,
  buttons: Array.from({ length: 17 }, (_, number) => ({
    pressed: number === 4 && pad.held
      && !(pad.obeys && document.querySelector("#hands").innerText.includes("release its button")),
  })),
}]; }"""
LEFT = [-1.0, 0.0, 0.0, 0.0]
