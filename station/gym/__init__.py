"""Gymnasium environments on the loaded model; importing this registers them. Needs the extra `gym`.

gymnasium.make("station.gym:CtrReach-v0", load=0.3)
"""

import gymnasium

#: Steps of an episode. Of the 15 s to reach a point, a half turn of a tube takes 9.
REACH_STEPS, TRACK_STEPS = 150, 400


def register() -> None:
    """Make both known to Gymnasium, once."""
    for name, task, steps in (("CtrReach-v0", "Reach", REACH_STEPS), ("CtrTrack-v0", "Track", TRACK_STEPS)):
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                f"station.gym.environments:{task}Env",
                max_episode_steps=steps,
                vector_entry_point=f"station.gym.environments:{task}VectorEnv",
            )


register()
