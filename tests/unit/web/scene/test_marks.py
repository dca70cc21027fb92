"""The two arrows of directions at the tip; an unknown direction has none."""

import numpy as np
import viser

from web.scene.marks import ARROW_LENGTH_M, PointingMark

TIP, OBSERVED, DESIRED = np.array([0.01, 0.02, 0.1]), np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.0, 1.0])


def test_direction_arrows_start_at_the_tip_and_are_visible_while_their_direction_is_known(
    server: viser.ViserServer,
) -> None:
    mark = PointingMark(server.scene, 10.0)
    observed, desired = mark._observed, mark._desired
    assert not observed.visible
    mark.draw(TIP, OBSERVED, DESIRED)
    for arrow, direction in ((observed, OBSERVED), (desired, DESIRED)):
        assert arrow.visible
        np.testing.assert_allclose(arrow.points, [[TIP, TIP + ARROW_LENGTH_M * direction]], atol=1e-6)
    mark.draw(TIP, OBSERVED, None)
    assert observed.visible
    assert not desired.visible
    mark.draw(None, OBSERVED, DESIRED)
    assert not observed.visible
    assert not desired.visible
