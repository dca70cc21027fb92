"""Table `[devices]` of a station file with the drivers of the paper's bench, for tests that open no device."""

OWN_DEVICES = """
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"
[devices.sensors]
driver = "netft"
tubes.inner.host = "192.168.1.11"
tubes.outer.host = "192.168.1.12"
"""
