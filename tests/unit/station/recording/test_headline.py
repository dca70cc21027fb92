"""First line of a result: the main number of each kind of experiment, and the omitted numbers."""

import pytest

from station.recording.headline import HEADLINES, headline

ERRORS = {"true_max_abs_error_mm": [1.0, 2.0, 2.0], "true_rms_error_mm": [0.3, 0.0, 0.4], "true_max_distance_mm": 3.0}
TRACKED = {key.removeprefix("true_"): value for key, value in ERRORS.items()} | {"max_distance_mm": 12.34}
PRESS = {"desired_N": 0.2, "max_N": 0.2712, "contact_s": 1.4, "held_s": 4.84}
PALPATION = {"stiffness_N_per_m": [[235.1, None], [185.2, 346.6]], "rms_relative_error": 0.081}
STEP = {"rate": 4.88, "dead_time_s": 0.041, "expected_rate": 5.0}
MODEL = {"model_error_mm": {"loaded": 1.2, "unloaded": 11.0}, "counted_from_s": 2.0}
DEFLECTION = {"deflection_max_mm": {"deflection": [6.0, 1.0, 2.0], "delta_1": [7.0, 0, 0], "delta_2": [0.5, 0, 0]}}
NO_CONTACT = {"desired_N": 0.2, "max_N": 0.01}


@pytest.mark.parametrize(
    ("cases", "line"),
    [
        ([ERRORS | {"counted_from_s": 2.0, "force_max_N": 0.5}],
         "3.00 mm largest true error, RMS 0.50 mm, from 2.0 s on (earlier errors are not counted); force at most"
         " 0.50 N"),
        ([ERRORS | {"force_max_N": 0.1, "force_unknown": "yz"}, ERRORS | {"force_unknown": "xyz"}],
         "3.00 mm largest true error, RMS 0.50 mm, over the whole motion; force at most 0.10 N;"
         " force unknown and left out along x and y and z in 1 of 2 cases, y and z in 1 of 2 cases"),
        ([TRACKED], "12.3 mm largest tracker error, RMS 0.50 mm, over the whole motion"),
        ([ERRORS, {"completed": False}],
         "3.00 mm largest true error, RMS 0.50 mm, over the whole motion (1 of 2 cases)"),
        ([ERRORS | {"press": PRESS}],
         "0.27 N largest force, 0.20 N desired, 0.07 N above it; contact after 1.4 s, within 10 % for 4.8 s"),
        ([ERRORS | {"press": PRESS}, ERRORS | {"press": NO_CONTACT}],
         "0.01 … 0.27 N largest force, 0.20 N desired, at most 0.07 N above it; contact after 1.4 s, within 10 % for"
         " 4.8 s; no contact in 1 of 2 cases"),
        ([ERRORS | {"press": PRESS, "palpation": PALPATION}],
         "185 … 347 N/m estimated stiffness of 4 places, 1 of them unknown; relative error against the simulated"
         " tissue: RMS 8 %"),
        ([ERRORS | {"step": STEP}], "4.88 1/s fitted rate, 5.00 1/s by eq. (31); dead time 41 ms"),
        ([MODEL],
         "1.20 mm mean distance of the loaded model from the measured tip, 11.0 mm without load, from 2.0 s on"),
    ],
)  # fmt: skip
def test_first_line_is_what_the_experiment_is_for(cases: list[dict[str, object]], line: str) -> None:
    found = headline({"experiment": "own", "cases": dict(zip("abc", cases, strict=False))})
    assert str(found) == line


def test_first_line_of_fig4_is_its_deflection() -> None:
    found = str(headline({"experiment": "fig4", "cases": {"a": ERRORS | DEFLECTION}}))
    assert found.startswith("6.00 mm largest deflection along an axis, by the model; part of the load 7.00 mm,")


@pytest.mark.parametrize(
    "cases", [None, {}, {"a": 3}, {"a": {"completed": False}}, *({"a": {k: 3}} for k, _ in HEADLINES)]
)
def test_summary_without_a_valid_number_has_no_first_line(cases: object) -> None:
    assert headline({"cases": cases}) is None
