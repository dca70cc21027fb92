"""File of the golden cases' digests and sampled values, and the comparison of new ones with it.

Loaded machine code gives the same bits in every process, whichever process compiled it, but a process that compiles
code gives other last digits, and so do another processor type or other versions of the libraries. On the machine type
that wrote the file, the digests of all bits are therefore compared, elsewhere sampled values with a tolerance.
"""

import base64
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding as llvm
import numpy as np

from core.robot.robot import Array
from tests.harness.root import ROOT

FILE = Path(__file__).with_name("expected.json")
#: Largest difference of a sampled value on another machine type, relative to the largest sample of its channels, and
#: the smallest magnitude to which it refers.
TOLERANCE, SMALLEST = 1e-6, 1e-3
REWRITE = "python -m tests.golden --write"
REASON = f"If the change is intended, run '{REWRITE}', and the commit must say why the numbers change."


class Record(NamedTuple):
    """Digests and samples of one case."""

    channels: Mapping[str, str]  #: digest of the bits, by channel
    samples: Mapping[str, list[float]]  #: values in the middle and at the end, by channel

    @property
    def digest(self) -> str:
        """Digest of all channels' names and bits."""
        return hashlib.sha256(json.dumps(dict(self.channels)).encode()).hexdigest()[:16]


def record(numbers: Mapping[str, Array]) -> Record:
    """Return the record of a case's numbers."""
    return Record(
        {name: f"{zlib.crc32(np.ascontiguousarray(values).tobytes()):08x}" for name, values in numbers.items()},
        {name: values[[len(values) // 2, -1]].tolist() for name, values in numbers.items()},
    )


def machine() -> str:
    """Return what determines the last digits: processor type and features, and versions of the libraries."""
    features = hashlib.sha256(llvm.get_host_cpu_features().flatten().encode()).hexdigest()[:8]
    packages = (f"{name} {version(name)}" for name in ("numba", "llvmlite", "numpy", "scipy"))
    parts = f"{llvm.get_host_cpu_name()} {features}", *packages, " ".join(platform.libc_ver())
    return ", ".join((*parts, f"python {platform.python_version()}"))


def records(names: Sequence[str] = ()) -> dict[str, Record]:
    """Run cases in a process that only loads compiled code; without `names` all cases.

    Raises:
        subprocess.CalledProcessError: a case raised an error; its traceback is on stderr.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "records.json"
        command = [sys.executable, "-m", "tests.golden.child", str(out), *names]
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        for _ in range(2):  # the first process may compile
            subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, **threads, "PYTHONHASHSEED": "0"})
            found = json.loads(out.read_text(encoding="utf-8"))
            if not found["compiled"]:
                break
        else:
            raise AssertionError(
                f"code was compiled twice; is the folder of compiled code writable? {found['compiled']}"
            )
    return {name: Record(*one) for name, one in found["records"].items()}


def write(found: Mapping[str, Record]) -> None:
    """Write the file of expected records: one line for each case."""
    lists: list[list[str]] = []
    lines: list[str] = []
    for name, one in found.items():
        names = list(one.channels)
        if names not in lists:
            lists.append(names)
        digests = b"".join(bytes.fromhex(digest)[:2] for digest in one.channels.values())
        samples = np.array(list(one.samples.values()), np.float32).tobytes()
        packed = [base64.b85encode(zlib.compress(part, 9)).decode() for part in (digests, samples)]
        lines.append(json.dumps(name) + ": " + json.dumps([one.digest, lists.index(names), *packed]))
    head = f'"machine": {json.dumps(machine())},\n"channels": {json.dumps([" | ".join(names) for names in lists])}'
    FILE.write_text(f'{{\n{head},\n"cases": {{\n' + ",\n".join(lines) + "\n}\n}\n", encoding="utf-8")


class Expected(NamedTuple):
    """Expected numbers of one case."""

    digest: str
    channels: Mapping[str, tuple[str, Array]]  #: first digits of the digest, and samples (2,), by channel


def expected() -> tuple[str, dict[str, Expected]]:
    """Return the machine that wrote the file, and the expected cases."""
    table = json.loads(FILE.read_text(encoding="utf-8"))
    cases: dict[str, Expected] = {}
    for name, (digest, names, *packed) in table["cases"].items():
        digests, samples = (zlib.decompress(base64.b85decode(part)) for part in packed)
        values = np.frombuffer(samples, np.float32).reshape(-1, 2).astype(np.float64)
        channels = table["channels"][names].split(" | ")
        shorts = [digests[2 * i : 2 * i + 2].hex() for i in range(len(channels))]
        cases[name] = Expected(digest, dict(zip(channels, zip(shorts, values, strict=True), strict=True)))
    return table["machine"], cases


def changed(known: Expected, found: Record, *, bits: bool) -> list[str]:
    """Return the channels that differ; `bits`: whether every bit counts, otherwise the samples with a tolerance."""
    if bits and known.digest == found.digest:
        return []
    names = list(dict.fromkeys((*known.channels, *found.channels)))
    return [name for name in names if _differs(known, found, name, bits=bits)]


def _differs(known: Expected, found: Record, name: str, *, bits: bool) -> bool:
    if name not in known.channels or name not in found.channels:
        return True
    short, samples = known.channels[name]
    if bits:
        return not found.channels[name].startswith(short)
    group = name.rsplit(".", 1)[0]
    scale = max(np.abs(one).max() for other, (_, one) in known.channels.items() if other.rsplit(".", 1)[0] == group)
    return bool((np.abs(samples - found.samples[name]) > TOLERANCE * max(scale, SMALLEST)).any())


def report(known: Mapping[str, Expected], found: Mapping[str, Record], *, bits: bool) -> Iterator[str]:
    """Yield a line for each case that differs, with the names of its channels."""
    for name in dict.fromkeys((*known, *found)):
        if name not in known:
            yield f"{name}: a new case"
        elif name not in found:
            yield f"{name}: the case is missing"
        elif channels := changed(known[name], found[name], bits=bits):
            count = f"{len(channels)} of {len(found[name].channels)} channels"
            yield f"{name}: {', '.join(channels[:12])}{' ...' if len(channels) > 12 else ''} ({count})"
