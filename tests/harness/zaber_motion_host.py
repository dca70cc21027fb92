"""A host with the manufacturer's library: `python -m tests.harness.zaber_motion_host PORT`.

It reads lines `DEVICE AXIS COMMAND`, and prints a line of JSON with the answers to each. The library leaves threads
behind, so it runs in its own process.
"""

import json
import sys

from zaber_motion import CommandFailedException, MotionLibException
from zaber_motion.ascii import Connection


def main() -> None:
    """Execute the commands of the standard input until it ends."""
    with Connection.open_tcp("127.0.0.1", int(sys.argv[1])) as connection:
        connection.checksum_enabled = True
        for line in sys.stdin:
            device, axis, command = line.rstrip("\n").split(" ", 2)
            try:
                answers = connection.generic_command_multi_response(command, int(device), int(axis))
                found = [[a.device_address, a.reply_flag, a.status, a.warning_flag, a.data] for a in answers]
            except CommandFailedException as error:
                why = error.details
                found = [[int(device), "RJ", why.status, why.warning_flag, why.response_data]]
            except MotionLibException as error:
                found = [[int(device), type(error).__name__, "", "", str(error)]]
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
