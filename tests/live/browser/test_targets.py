"""A run that follows an external program's target, started on the page and ended by STOP."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from pyigtl import OpenIGTLinkClient
from pyigtl.messages import TransformMessage

from tests.harness.chromium import open_tab, press_until_sent
from tests.harness.gateway_clients import igtl_client
from tests.harness.serving import Served, serving


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving("--igtl", "0") as served:
        yield served


@pytest.fixture
def client(running: Served) -> Iterator[OpenIGTLinkClient]:
    with igtl_client(running) as client:
        yield client


def test_operator_starts_following_an_external_target_and_stop_ends_it(
    page: Page, station: Served, client: OpenIGTLinkClient
) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="external target").click()
    expect(page.locator("#start").get_by_label("speed")).to_have_value("20")  # mm/s
    page.get_by_label("end", exact=True).fill("60")
    press_until_sent(page, page.get_by_role("button", name="Start following").click, "/api/gateway/target")
    page.locator("#state", has_text="RUNNING").wait_for()
    station.wait_for(lambda status: status["phase"] == "moving")
    begun = np.array(station.status()["tip_desired"])
    goal = np.eye(4)
    goal[:3, 3] = 1e3 * begun + [0.0, 0.0, 2.0]
    while np.abs(1e3 * np.array(station.status()["tip_desired"]) - goal[:3, 3]).max() > 0.02:
        client.send_message(TransformMessage(goal, device_name="Target"))
        time.sleep(0.02)
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
