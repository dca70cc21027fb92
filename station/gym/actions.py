"""What may be done in a step: a part, -1 ... 1, of every joint's speed."""

import numpy as np
from gymnasium.spaces import Box

from core.robot.robot import Array


class Actions(Box):
    """The box of them; drawing from it is quick, as it knows that it ends on every side."""

    def __init__(self, joints: int) -> None:
        super().__init__(-1.0, 1.0, (joints,), dtype=np.float64)

    def sample(self, mask: None = None, probability: None = None) -> Array:
        """To the last bit what a `Box` draws, which takes as long as two solves."""
        if mask is not None or probability is not None:
            return super().sample(mask, probability)  # says why not
        return 2.0 * self.np_random.random(self.shape) - 1.0
