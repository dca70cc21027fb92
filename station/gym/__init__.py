"""Gymnasium environments of robots that the loaded model simulates. Importing this package registers them.

The package needs the extra `gym`. Example:

    gymnasium.make("station.gym:CtrReach-v0", load=0.3)
"""

import gymnasium

#: Number of steps in an episode of `CtrReach-v0` and of `CtrTrack-v0`. An episode of `CtrReach-v0` lasts 15 s of
#: simulated time by default, because a half turn of a tube takes 9 s.
REACH_STEPS, TRACK_STEPS = 150, 400


def register() -> None:
    """Register both environments with Gymnasium; a second call has no effect."""
    for name, task, steps in (("CtrReach-v0", "Reach", REACH_STEPS), ("CtrTrack-v0", "Track", TRACK_STEPS)):
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                f"station.gym.environments:{task}Env",
                max_episode_steps=steps,
                vector_entry_point=f"station.gym.environments:{task}VectorEnv",
            )


register()
