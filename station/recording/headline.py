"""First line of a result: its main number with an explanation. Page, report, terminal and JSON show this line."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from station.config.strict import Strict
from station.recording.run_outcome import CaseOutcome, case_outcomes

Cases = Sequence[Mapping[str, Any]]


class Headline(Strict):
    """First line of a result."""

    number: str
    """the number with its unit; for several cases, the smallest and the largest number"""
    sentence: str
    """meaning of the number, and what it does not include"""

    def __str__(self) -> str:
        """Return the line."""
        return f"{self.number} {self.sentence}"


def headline(summary: Mapping[str, Any]) -> Headline | None:
    """Return the first line of a run's result; None if its summary has no such number or is invalid."""
    cases = summary.get("cases")
    numbers = [one for one in cases.values() if isinstance(one, Mapping)] if isinstance(cases, Mapping) else []
    for key, line in HEADLINES:
        chosen = [one for one in numbers if key in one or summary.get("experiment") == key]
        if not chosen:
            continue
        try:
            number, sentence = line(chosen)
        except (AttributeError, KeyError, TypeError, ValueError):
            return None
        part = f" ({len(chosen)} of {len(numbers)} cases)" if len(chosen) < len(numbers) else ""
        return Headline(number=number, sentence=sentence + part)
    return None


def span(values: Sequence[float], unit: str, digits: int | None = None) -> str:
    """Return the smallest and the largest value as a text with a unit.

    `digits` is the number of digits after the point; None: two below 10, otherwise one.
    """
    low, high = (
        f"{one:.{(2 if one < 10.0 else 1) if digits is None else digits}f}" for one in (min(values), max(values))
    )
    return f"{high} {unit}" if low == high else f"{low} … {high} {unit}"


def largest_force(outcomes: Sequence[CaseOutcome]) -> str:
    """Return a phrase with the largest force, and the axes along which the force is unknown and left out."""
    forces = [one.force for one in outcomes if one.force is not None]
    unknown = Counter(one.force_unknown for one in outcomes if one.force_unknown)
    left_out = ", ".join(
        f"{' and '.join(axes)}{f' in {count} of {len(outcomes)} cases' if count < len(outcomes) else ''}"
        for axes, count in sorted(unknown.items())
    )
    found = f"; force at most {max(forces):.2f} N" if forces else ""
    return found + (f"; force unknown and left out along {left_out}" if left_out else "")


def _tip(cases: Cases) -> tuple[str, str]:
    outcomes = list(case_outcomes({"cases": dict(enumerate(cases))}).values())
    if len(outcomes) < len(cases):
        raise ValueError("the tip errors of a case are missing or invalid")
    kind = "true error" if outcomes[0].against == "true" else "tracker error"
    largest, rms = (span([getattr(one, key) for one in outcomes], "mm") for key in ("largest_distance", "rms_distance"))
    starts = span([one.counted_from for one in outcomes], "s on", 1)
    since = f"from {starts} (earlier errors are not counted)" if starts != "0.0 s on" else "over the whole motion"
    return largest, f"largest {kind}, RMS {rms}, {since}{largest_force(outcomes)}"


def _force(cases: Cases) -> tuple[str, str]:
    found = [one["press"] for one in cases]
    above = max(one["max_N"] - one["desired_N"] for one in found)
    touched = [one for one in found if "contact_s" in one]
    sentence = f"largest force, {span([one['desired_N'] for one in found], 'N', 2)} desired"
    if above > 0.0:
        sentence += f", {'at most ' if len(found) > 1 else ''}{above:.2f} N above it"
    if touched:
        sentence += f"; contact after {span([one['contact_s'] for one in touched], 's', 1)}"
        sentence += f", within 10 % for {span([one['held_s'] for one in touched], 's', 1)}"
    if len(touched) < len(found):
        sentence += f"; no contact{f' in {len(found) - len(touched)} of {len(found)} cases' if touched else ''}"
    return span([one["max_N"] for one in found], "N", 2), sentence


def _stiffness(cases: Cases) -> tuple[str, str]:
    found = [one["palpation"] for one in cases]
    places = [value for one in found for row in one["stiffness_N_per_m"] for value in row]
    known = [value for value in places if value is not None]
    errors = [100.0 * one["rms_relative_error"] for one in found if "rms_relative_error" in one]
    sentence = f"estimated stiffness of {len(places)} places"
    if len(known) < len(places):
        sentence += f", {len(places) - len(known)} of them unknown"
    if errors:
        sentence += f"; relative error against the simulated tissue: RMS {span(errors, '%', 0)}"
    return span(known, "N/m", 0) if known else "unknown", sentence


def _step(cases: Cases) -> tuple[str, str]:
    rate, dead_time, expected = (
        [one["step"][key] for one in cases] for key in ("rate", "dead_time_s", "expected_rate")
    )
    return span(rate, "1/s"), (
        f"fitted rate, {span(expected, '1/s')} by eq. (31); dead time {span([1e3 * one for one in dead_time], 'ms', 0)}"
    )


def _model(cases: Cases) -> tuple[str, str]:
    loaded, unloaded = ([one["model_error_mm"][key] for one in cases] for key in ("loaded", "unloaded"))
    since = span([one["counted_from_s"] for one in cases], "s", 1)
    return span(loaded, "mm"), (
        f"mean distance of the loaded model from the measured tip, {span(unloaded, 'mm')} without load, from {since} on"
    )


def _deflection(cases: Cases) -> tuple[str, str]:
    total, load, joints = (
        span([max(one["deflection_max_mm"][key]) for one in cases], "mm")
        for key in ("deflection", "delta_1", "delta_2")
    )
    return total, f"largest deflection along an axis, by the model; part of the load {load}, of the joints {joints}"


#: Kinds of first lines: name of an experiment, or key that a case's summary has only in this kind of experiment; and
#: the function that writes the line. The first entry that matches a run is used.
HEADLINES: tuple[tuple[str, Callable[[Cases], tuple[str, str]]], ...] = (
    ("fig4", _deflection),
    ("palpation", _stiffness),
    ("press", _force),
    ("step", _step),
    ("true_max_abs_error_mm", _tip),
    ("max_abs_error_mm", _tip),
    ("model_error_mm", _model),
)
