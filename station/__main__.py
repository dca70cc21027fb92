"""Entry point of `python -m station`: run the command line and exit with its status."""

import sys

try:
    from station.cli.main import main

    status = main()
except KeyboardInterrupt:  # during the imports, which take seconds on a busy computer
    sys.stderr.write("ctr-station: interrupted\n")
    status = 130
sys.exit(status)
