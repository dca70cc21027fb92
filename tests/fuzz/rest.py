"""Fuzz test of the REST interface of a running station: `python -m tests.fuzz.rest 10000 SEED`.

Valid bodies are corrupted, cut, nested, and filled with invalid numbers and names. The fuzzer looks for answers with a
server error (5xx), refusals without a reason, and motion that no request asked for.
"""

import json
import random
import sys
from collections import Counter, deque
from typing import Any

import httpx

from tests.harness.serving import Served, serving

JSON = {"content-type": "application/json"}
#: Method, path and valid body of each request. `MOVES` has the requests that move the robot; the second list has the
#: requests that only set or query values.
MOVES: list[tuple[str, str, Any]] = [
    ("POST", "/api/start", {"trajectory": {"kind": "circle", "radius": 0.005, "period": 20.0}, "duration": 5.0}),
    ("POST", "/api/start", {"experiment": "fig10", "case": "paper"}),
    ("POST", "/api/jog", {"space": "tip", "velocity": [0.0, 0.0, 0.001]}),
    ("POST", "/api/jog", {"space": "joints", "velocity": [0.0, 0.01, 0.0]}),
    ("POST", "/api/home", {"way_is_clear": True}),
    ("POST", "/api/goto", {"joints": {"inner_rotation": 1.5}}),
    ("POST", "/api/calibration/start", {"what": "force", "effort": 1.0, "weights": [0.2, 0.5], "way_is_clear": True}),
]
OTHERS: list[tuple[str, str, Any]] = [
    ("PUT", "/api/trajectory", {"kind": "sinusoid", "direction": [0, 0, 1], "amplitude": 0.01, "frequency": 0.05}),
    ("PUT", "/api/controller", {"strategy": "dual_layer", "k1": 2.5, "k2": 2.5}),
    ("POST", "/api/model/solve", {"joints": {"outer_rotation": 0.0}, "force": [0.1, 0.0, 0.0]}),
    ("POST", "/api/operator", {"name": "somebody", "take_over": True}),
    ("POST", "/api/load", {"load": {"kind": "constant", "magnitude": 0.1}}),
    ("POST", "/api/faults", {"faults": [{"kind": "stall", "device": "nobody", "duration": 1.0}]}),
    ("POST", "/api/tare", {}),
    ("DELETE", "/api/faults", None),
    ("POST", "/api/calibration/done", {}),
    ("POST", "/api/calibration/abort", {}),
    ("POST", "/api/calibration/exchange", {"robot": "three_tubes"}),
    ("POST", "/api/calibration/exchange", {"file": "name = 'own'\n[[tubes]]\n"}),
    ("POST", "/api/nothing", {}),
]
ODD: list[Any] = [
    None, True, -1, 0, 1e308, -1e-308, 10**400, "", "\u0000", "NaN", [], {}, [[]], {"": 0}, "x" * 5000, [0] * 500,
]  # fmt: skip


class RestFuzz:
    """Fuzzer of one station, with the findings in the station's answers."""

    def __init__(self, station: Served, seed: int) -> None:
        self.station, self.chance = station, random.Random(seed)
        self.answers: Counter[int] = Counter()
        self.wrong: list[str] = []
        self.taken: deque[str] = deque(maxlen=12)  #: last requests that the station has accepted
        self._joints = self._at_rest()

    def one(self) -> None:
        """Send one request and check its answer and its effect."""
        method, path, body = self.chance.choice(MOVES if self.chance.random() < 0.4 else OTHERS)
        raw = self._damaged(body)
        headers = JSON if self.chance.random() < 0.9 else {"content-type": self.chance.choice(("text/plain", "", "é"))}
        try:
            answer = self.station.rest.request(method, path, content=raw, headers=headers)
        except (httpx.HTTPError, UnicodeError) as error:
            if isinstance(error, UnicodeError):
                return  # httpx refuses to send such a header
            self.wrong.append(f"{method} {path} {raw[:80]!r}: {error!r}")
            return
        self.answers[answer.status_code] += 1
        if answer.status_code >= 500:
            self.wrong.append(f"{answer.status_code}: {method} {path} {raw[:200]!r}: {answer.text[:200]}")
        if 400 <= answer.status_code < 500 and path != "/api/nothing" and not _reason(answer):
            self.wrong.append(f"{answer.status_code} without a reason: {method} {path} {raw[:200]!r}")
        if answer.is_success:
            self.taken.append(f"{method} {path} {raw[:300]!r}")
        moved = answer.is_success and any(path == way for _, way, _ in MOVES)
        if moved:
            self._joints = self._at_rest()
        elif self.chance.random() < 0.2:
            self._look(f"{method} {path} {raw[:200]!r}")

    def _look(self, after: str) -> None:
        """Check that no joint has moved and no run has started."""
        status = self.station.status()
        if status["state"] not in ("READY", "HOLD", "FAULT") or status["joints"] != self._joints:
            self.wrong.append(f"motion that nobody asked for after {after}: {status['state']}")
            self._joints = self._at_rest()

    def _at_rest(self) -> dict[str, float]:
        """Stop every motion; return the joint positions at rest."""
        self.station.rest.post("/api/stop")
        self.station.rest.post("/api/load", json={"load": {"kind": "none"}})
        self.station.rest.delete("/api/faults")
        self.station.ready()
        return self.station.wait_for(lambda status: status["joints"] == self._joints_of())["joints"]

    def _joints_of(self) -> dict[str, float]:
        return self.station.status()["joints"]

    def _damaged(self, body: Any) -> bytes:
        chance = self.chance
        way = chance.random()
        if body is None or way < 0.1:
            return bytes(chance.randrange(256) for _ in range(chance.choice((0, 1, 7, 300))))
        if way < 0.15:
            return b"[" * chance.randrange(1, 60_000)
        if way < 0.17:
            return b" " * chance.randrange(60_000, 200_000)
        if way < 0.6:
            body = self._odd(body)
        text = json.dumps(body)
        if way < 0.3:
            text = text.replace("0.0", chance.choice(("NaN", "Infinity", "-Infinity", "1e999", "0x1", "0.0.0", "null")))
        raw = bytearray(text.encode())
        if 0.6 <= way < 0.95 and raw:
            for _ in range(chance.randint(1, 4)):
                at = chance.randrange(len(raw))
                raw[at : at + chance.randrange(2)] = bytes([chance.randrange(256)])
        return bytes(raw[: chance.randrange(len(raw) + 1)] if way > 0.9 else raw)

    def _odd(self, body: Any) -> Any:
        """Return the body with one invalid value in it."""
        if isinstance(body, dict) and body and self.chance.random() < 0.8:
            key = self.chance.choice(list(body))
            if self.chance.random() < 0.2:
                return {**body, f"{key}_": 1}
            return {**body, key: self._odd(body[key])}
        if isinstance(body, list) and body and self.chance.random() < 0.5:
            at = self.chance.randrange(len(body))
            return [self._odd(item) if i == at else item for i, item in enumerate(body)]
        return self.chance.choice(ODD)


def _reason(answer: httpx.Response) -> str:
    try:
        return str(answer.json()["error"])
    except (ValueError, KeyError, TypeError):
        return ""


def fuzz(station: Served, requests: int, seed: int) -> RestFuzz:
    """Send `requests` requests to a station and return the fuzzer with its findings."""
    fuzzed = RestFuzz(station, seed)
    for _ in range(requests):
        try:
            fuzzed.one()
        except AssertionError as error:
            taken = "\n".join(fuzzed.taken)
            raise AssertionError(
                f"{error}\nafter {sum(fuzzed.answers.values())} answers, the last accepted:\n{taken}"
            ) from None
    return fuzzed


def main() -> None:
    """Send as many requests as the first argument specifies."""
    requests, seed = [int(word) for word in sys.argv[1:3]] + [10_000, 1][len(sys.argv) - 1 :]
    with serving() as station:
        fuzzed = fuzz(station, requests, seed)
    for line in fuzzed.wrong[:20]:
        sys.stdout.write(f"{line}\n")
    sys.stdout.write(f"{requests} requests: {dict(sorted(fuzzed.answers.items()))}, {len(fuzzed.wrong)} wrong\n")
    sys.exit(bool(fuzzed.wrong))


if __name__ == "__main__":
    main()
