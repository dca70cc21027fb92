"""Robot files that are variants of the presets."""

from station.config.strict import PRESETS


def straight_outer(preset: str, curvature: float) -> str:
    """Return the text of a preset robot whose outer tube has this curvature [1/m] and whose inner tube bends more."""
    text = (PRESETS / "robots" / f"{preset}.toml").read_text(encoding="utf-8").replace('integrator = "paper"', "")
    inner, outer = text.split('name = "outer"', 1)
    curved = {"paper": "[4.0, 0.0]", "three_tubes": "[7.0, 0.0]"}[preset]
    assert curved in outer
    return inner.replace("[4.0, 0.0]", "[12.0, 0.0]") + 'name = "outer"' + outer.replace(curved, f"[{curvature}, 0.0]")
