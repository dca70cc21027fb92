"""Action space of the environments: for every joint a fraction, -1 ... 1, of its top speed."""

import numpy as np
from gymnasium.spaces import Box

from core.robot.robot import Array


class Actions(Box):
    """Gymnasium `Box` with a faster method `sample`, which is possible because all bounds are finite."""

    def __init__(self, joints: int) -> None:
        super().__init__(-1.0, 1.0, (joints,), dtype=np.float64)

    def sample(self, mask: None = None, probability: None = None) -> Array:
        """Return a random action, bit for bit the action that `Box.sample` would return.

        `Box.sample` takes as long as two solutions of the model.
        """
        if mask is not None or probability is not None:
            return super().sample(mask, probability)  # `Box.sample` refuses these arguments and gives the reason
        return 2.0 * self.np_random.random(self.shape) - 1.0
