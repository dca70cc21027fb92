"""Checks whether a driver of a tracker or of force sensors meets the requirements, on a real or simulated device."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from station.devices.driver_check.calls import Calls
from station.devices.driver_check.requirements import (
    CONNECT_S,
    MAX_AGE_S,
    MAX_DISTANCE_M,
    Broken,
    Finding,
    Must,
    one_finding_each,
)
from station.devices.guard import tip_reading, wrench_reading
from station.devices.interfaces import BaseSensors, Clock, Condition, DeviceKind, TipReading, Tracker, WrenchReading

WATCH_S = 3.0  #: duration for which a device is observed [s]
MAX_RATE_ERROR = 0.3  #: largest relative error of the rate at which times increase; delays vary on a busy computer


def check_tracker(opens: Callable[[], Tracker], clock: Clock) -> Iterator[Finding]:
    """Check a driver of a tracker; the tracker must see its coil during the check."""

    def judge(readings: Sequence[tuple[float, TipReading]]) -> Iterator[Finding]:
        frames = [reading for _, reading in readings]
        rising = all(a.frame < b.frame for a, b in pairwise(frames))
        yield Finding(Must.FRAME_NUMBERS, rising, "increase" if rising else "do not increase")
        valid = all(_is_valid(frame) for frame in frames)
        still = len({tuple(frame.position) for frame in frames}) == 1
        text = ("finite, in metres" if valid else "not finite, too far away, or a direction without length 1") + (
            "; all are equal: does the tracker measure?" if still else ""
        )
        yield Finding(Must.POSITIONS, valid, text)

    return _check("tracker", opens, tip_reading, clock, judge)


def check_sensors(opens: Callable[[], BaseSensors], tubes: int, clock: Clock) -> Iterator[Finding]:
    """Check a driver of the force sensors of `tubes` tubes."""

    def judge(readings: Sequence[tuple[float, WrenchReading]]) -> Iterator[Finding]:
        valid = all(bool(np.isfinite(reading.wrenches).all()) for _, reading in readings)
        still = all((reading.wrenches == readings[0][1].wrenches).all() for _, reading in readings)
        text = ("finite" if valid else "not finite") + ("; all are equal: does each sensor measure?" if still else "")
        yield Finding(Must.WRENCHES, valid, text)

    return _check("sensors", opens, partial(wrench_reading, tubes=tubes), clock, judge)


def _is_valid(frame: TipReading) -> bool:
    near = bool(np.linalg.norm(frame.position) <= MAX_DISTANCE_M)  # False for NaN
    return near and (frame.direction is None or abs(float(np.linalg.norm(frame.direction)) - 1.0) < 1e-3)


def _check(
    kind: DeviceKind, opens: Callable[[], Any], result: Callable[[Any], Any], clock: Clock,
    judge: Callable[[Sequence[tuple[float, Any]]], Iterator[Finding]],
) -> Iterator[Finding]:  # fmt: skip
    calls, opened = Calls(clock), list[Any]()

    def checks() -> Iterator[Finding]:
        try:
            opened.append(calls.guarded(opens(), result))
        except Exception as error:  # a foreign function can raise anything
            raise Broken(Must.CONNECTION, f"the device cannot be opened: {type(error).__name__}: {error}") from error
        (device,) = opened
        connected = _connected(device, calls, clock)
        start, readings, unusable = clock.now(), list[tuple[float, Any]](), 0
        while (now := clock.now()) - start < WATCH_S:
            reading = device.poll(now)
            fault = device.trouble(now)
            if device.condition is Condition.FAULT:
                raise Broken(Must.CONNECTION, f"the device entered the state fault: {fault or 'no cause reported'}")
            if reading is not None and getattr(reading, "usable", True):
                readings.append((now, reading))
            elif reading is not None:
                unusable += 1
            calls.end_tick()
        yield connected
        yield _samples(readings, unusable, start, now, device)
        if not readings:
            return
        yield _times(readings)
        yield from judge(readings)
        yield calls.duration()

    def end() -> None:
        try:
            for device in opened:
                device.close()
        finally:
            calls.close()

    return one_finding_each(kind, checks(), end)


def _connected(device: Any, calls: Calls, clock: Clock) -> Finding:
    start = clock.now()
    device.connect(start)
    while device.condition is Condition.CONNECTING and clock.now() - start < CONNECT_S:
        device.poll(clock.now())
        calls.end_tick()
    took, cause = clock.now() - start, device.trouble(clock.now()) or "no fault"
    if device.condition is not Condition.CONNECTED:
        raise Broken(Must.CONNECTION, f"{device.condition.value} after {took:.2f} s; {cause}")
    return Finding(Must.CONNECTION, True, f"connected after {took:.2f} s; {cause}")


def _samples(readings: Sequence[tuple[float, Any]], unusable: int, start: float, end: float, device: Any) -> Finding:
    new = [(now, reading.time) for now, reading in readings]
    arrivals = [start] + [now for (_, before), (now, time) in pairwise([(start, np.nan), *new]) if time != before]
    gap = max(b - a for a, b in pairwise([*arrivals, end]))
    text = f"{(len(arrivals) - 1) / WATCH_S:.1f} new samples a second, {unusable} unusable, longest gap {gap:.2f} s"
    good = gap <= MAX_AGE_S and not unusable
    return Finding(Must.SAMPLES, good, text if good else f"{text}; {device.trouble(end) or 'no cause reported'}")


def _times(readings: Sequence[tuple[float, Any]]) -> Finding:
    arrivals, times = (np.array(column) for column in zip(*((now, r.time) for now, r in readings), strict=True))
    ages, elapsed = arrivals - times, arrivals[-1] - arrivals[0]
    rate = float(times[-1] - times[0]) / elapsed if elapsed > 0.0 else 1.0
    plausible = (np.diff(times) >= 0.0).all() and (ages >= 0.0).all() and np.median(ages) <= MAX_AGE_S
    text = f"{1e3 * ages.min():.0f} to {1e3 * ages.max():.0f} ms old; the times increase by {rate:.3f} s each second"
    return Finding(Must.TIMES, bool(plausible and abs(rate - 1.0) <= MAX_RATE_ERROR), text)
