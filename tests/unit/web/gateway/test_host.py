"""Messages of the station process to the gateway."""

from web.gateway.host import gains_of


def test_controller_gains_are_named_by_their_keys_and_only_values_are_sent():
    controller = {
        "strategy": "best",
        "k1": 2.5,
        "feedforward": True,
        "none": None,
        "list": [1.0],
        "filter": {"rate": 3},
    }
    assert gains_of(controller) == (
        ("controller.strategy", "best"),
        ("controller.k1", 2.5),
        ("controller.feedforward", True),
        ("controller.filter.rate", 3),
    )
