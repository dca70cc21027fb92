"""The web application in the test's process, on a station that is OFF and has no processes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import viser
from starlette.testclient import TestClient

from station.config.strict import EXPERIMENTS_VARIABLE
from station.service.audit import Audit
from station.service.live_calibration import LiveCalibration
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from web.access.identity import Tokens
from web.app import build_app
from web.scene.view import SceneView

HOST, PORT = "127.0.0.1", 8000


@contextmanager
def web_app(folder: Path, host: str = HOST, tokens: Tokens | None = None) -> Iterator[TestClient]:
    """Yield a client that calls the application without a network; runs, calibrations and the log are in `folder`.

    Args:
        folder: folder of runs, calibrations and the log.
        host: address of the station.
        tokens: access tokens, one of which every client needs; None: any client may become operator.
    """
    supervisor, audit = Supervisor(load_station(None).bench()), Audit(folder)
    own = os.environ.get(EXPERIMENTS_VARIABLE, "")
    server = viser.ViserServer(host=HOST, port=0, verbose=False)
    try:
        calibration = LiveCalibration(supervisor, folder / "calibrations")
        view = SceneView(server, supervisor)
        try:
            app = build_app(supervisor, view, calibration, folder, audit, host, PORT, tokens)
            with TestClient(app, base_url=f"http://{host}:{PORT}", client=(host, 50000)) as client:
                yield client
        finally:
            calibration.close()
            view.close()
    finally:
        server.stop()
        supervisor.close()
        audit.close()
        os.environ[EXPERIMENTS_VARIABLE] = own  # restored, because saving an experiment changes the variable
