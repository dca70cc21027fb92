"""A stand-in for a pad: what the browser tells of it from now on."""

#: A person who `obeys` lets go when the page asks for it; null: no pad.
PAD = """(pad) => { navigator.getGamepads = () => [pad === null ? null : {
  index: 0, id: "Test Pad (STANDARD GAMEPAD Vendor: 0000)", mapping: "standard", connected: true, axes: pad.axes,
  buttons: Array.from({ length: 17 }, (_, number) => ({
    pressed: number === 4 && pad.held
      && !(pad.obeys && document.querySelector("#hands").innerText.includes("let go of")),
  })),
}]; }"""
LEFT = [-1.0, 0.0, 0.0, 0.0]
