"""Print a digest of the bits of all channels for each golden case, or write the file of expected numbers.

    python -m tests.golden [CASE ...] [--channels] [--write]

`--channels` prints one digest for each channel, too. `--write` accepts the present numbers of all cases, and the commit
must say why they change.
"""

import argparse
import sys

from tests.golden.record import expected, machine, records, report, write


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--channels", action="store_true")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    if given.write and given.cases:
        parser.error("--write needs all cases")
    found = records(given.cases)
    for name, one in found.items():
        sys.stdout.write(f"{one.digest}  {name}\n")
        if given.channels:
            sys.stdout.writelines(f"    {digest}  {channel}\n" for channel, digest in one.channels.items())
    if given.write:
        write(found)
    else:
        wrote, known = expected()
        known = {name: known[name] for name in given.cases or known if name in known}
        sys.stdout.writelines(f"changed: {line}\n" for line in report(known, found, bits=wrote == machine()))


if __name__ == "__main__":
    main()
