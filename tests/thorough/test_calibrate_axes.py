"""`ctr-station calibrate axes` on the wire-level devices."""

import json


def test_calibrate_axes_detects_a_mirrored_stage_on_the_wire(call, write):
    lab = write('[hidden]\nmirrored = ["inner_rotation"]\n', "mirrored")

    done = call("calibrate", "axes", "--lab", str(lab), "--out", "found", "--json")

    assert done.status == 0, done.err
    assert json.loads(done.out)["signs"] == {"outer_rotation": 1.0, "inner_rotation": -1.0, "inner_translation": 1.0}
