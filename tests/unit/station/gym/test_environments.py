"""The environments pass Gymnasium's checks, and single and vector environments give the same results."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import station.gym
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.gym.bodies import Actions, EpisodeSettings, RobotBatch
from station.gym.environments import ReachEnv, ReachVectorEnv, TrackEnv, TrackVectorEnv

NAMES = ("station.gym:CtrReach-v0", "station.gym:CtrTrack-v0")
HIDDEN = {"load": 0.3, "tube_error": 0.1}


def same(one, other) -> bool:
    """Return whether observations are equal except for the last digits.

    They are equal bit for bit if one process has compiled all functions; parallel tests share the compiled functions.
    """
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return np.allclose(np.asarray(one, float), np.asarray(other, float), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("exact", [False, True])
def test_environments_pass_the_check_of_gymnasium(name, exact):
    station.gym.register()  # a second call has no effect
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(different from|flatten|render mode).*")
        check_env(gymnasium.make(name, exact=exact, render_mode="rgb_array", **HIDDEN).unwrapped)


@pytest.mark.parametrize("make", [ReachEnv, TrackEnv])
def test_seed_of_an_environment_determines_the_whole_episode(make):
    def episode(seed):
        env = make(**HIDDEN)
        random = np.random.default_rng(seed)
        observed = [env.reset(seed=seed)[0]]
        observed += [env.step(random.uniform(-1.0, 1.0, 3))[0] for _ in range(20)]
        return observed

    first, again, other = episode(1), episode(1), episode(2)
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize(
    ("many", "one", "more"),
    [
        (ReachVectorEnv, ReachEnv, HIDDEN),
        (TrackVectorEnv, TrackEnv, HIDDEN),
        (ReachVectorEnv, ReachEnv, {"exact": True, "reward": "dense"}),
        (ReachVectorEnv, ReachEnv, {"robot": "three_tubes", "load": 0.02}),
    ],
)
def test_vector_environment_equals_single_environments(many, one, more):
    """The environments also stay equal when episodes end and restart."""
    vector = many(num_envs=4, max_episode_steps=6, **more)
    singles = SyncVectorEnv([lambda: gymnasium.wrappers.TimeLimit(one(**more), 6)] * 4)
    assert same(vector.reset(seed=5)[0], singles.reset(seed=5)[0])
    vector.action_space.seed(0)
    for _ in range(15):
        actions = vector.action_space.sample()
        (observed, reward, over, cut, more_), (s, r, o, c, m) = vector.step(actions), singles.step(actions)
        assert same(observed, s)
        for ours, theirs in ((reward, r), (over, o), (cut, c)):
            assert same(ours, theirs)
        for key, value in m.items():
            if key.startswith("_"):
                assert np.array_equal(more_[key], value)
            else:
                assert same(more_[key][m[f"_{key}"]], value[m[f"_{key}"]])
    singles.close()


@pytest.mark.parametrize("robot", ["paper", "three_tubes"])
def test_joints_stay_in_their_travel_and_tubes_in_their_order(robot):
    file = load_robot(robot)
    bodies, limits = RobotBatch(EpisodeSettings(robot=robot, load=0.0, period=1.0), 8), file.limits()
    random = np.random.default_rng(0)
    for row in range(8):
        bodies.put(row, bodies.robot, bodies.draw_pose(random)[None], np.zeros(6))
    ends = np.zeros((8, bodies.lower.size), bool)
    directions = random.choice([-1.0, 1.0], ends.shape)
    for _ in range(40):
        bodies.move(7.0 * directions)
        for joints in bodies.joints:
            limits.check(joints)
            bodies.robot.check_pose(joints)
        ends |= (bodies.joints == bodies.lower) | (bodies.joints == bodies.upper)
    assert ends[:, ~bodies.slides].all()
    assert robot != "paper" or ends.all()
    assert np.abs(bodies.stride - limits.speed).max() == 0.0


def test_reward_of_a_step_matches_its_observation():
    env = ReachEnv(**HIDDEN)
    env.reset(seed=0)
    for _ in range(5):
        observed, reward, _, _, more = env.step(env.action_space.sample())
        assert reward == env.compute_reward(observed["achieved_goal"], observed["desired_goal"], more)
        assert more["is_success"] == (reward == 0.0)


@pytest.mark.parametrize("exact", [False, True])
def test_observed_tip_is_that_of_the_loaded_disturbed_robot(exact):
    """The tip depends on the disturbed tubes and the hidden load."""
    env = ReachEnv(exact=exact, **HIDDEN)
    env.reset(seed=3)
    for _ in range(10):
        observed = env.step(np.array([1.0, -0.5, 0.3]))[0]
    bodies = env.task.bodies
    model = (ExactRod if exact else Statics)(bodies.robots[0])
    tip = model.solve(bodies.joints[0], bodies.wrenches[0]).tip
    assert np.linalg.norm(observed["achieved_goal"] - tip) < 1e-8
    described = Statics(bodies.robot).solve(bodies.joints[0], np.zeros(6)).tip
    assert np.linalg.norm(tip - described) > 1e-3


def test_goal_is_reached_at_the_pose_that_was_drawn_for_it():
    env = ReachEnv(**HIDDEN)
    env.reset(seed=0)
    bodies, random = env.task.bodies, np.random.default_rng(0)
    poses = np.array([bodies.draw_pose(random) for _ in range(2)])
    env.task.goals[0] = bodies.put(0, bodies.robots[0], poses, bodies.wrenches[0])[1]
    for _ in range(400):
        _, reward, _, _, _ = env.step((poses[1] - bodies.joints[0]) / bodies.stride)
    assert reward == 0.0


def test_joints_from_which_a_path_was_drawn_follow_it_exactly_without_load():
    env = TrackEnv(load=0.0, steps=100)
    task = env.task
    drawn = []
    draw_joints = task._draw_joints
    task._draw_joints = lambda random: drawn.append(draw_joints(random)) or drawn[-1]
    env.reset(seed=0)
    for step in range(1, 100):
        _, reward, _, _, more = env.step((drawn[-1][step] - task.bodies.joints[0]) / task.bodies.stride)
        assert reward > -1e-3
        assert more["error"] < 1e-6


def test_load_of_the_tracking_task_starts_during_the_episode_and_stays():
    env = TrackEnv(load=0.3)
    env.reset(seed=1)
    forces = []
    for _ in range(400):
        env.step(np.zeros(3))
        forces.append(np.linalg.norm(env.task.bodies.wrenches[0]))
    assert forces[0] == 0.0
    assert forces[-1] == np.linalg.norm(env.task.loads[0]) > 0.0
    assert np.all(np.diff(forces) >= 0.0)


def test_rendered_picture_of_an_environment_changes_with_the_robots_pose():
    env = TrackEnv(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    for _ in range(50):
        env.step(np.array([1.0, 0.0, -1.0]))
    assert first.shape == (480, 480, 3)
    assert first.dtype == np.uint8
    assert (first != env.render()).any()
    assert TrackEnv().render() is None


@pytest.mark.parametrize("wrong", [{"load": -1.0}, {"tube_error": 2.0}, {"period": 0.0}, {"robot": "snake"}])
def test_invalid_settings_of_an_environment_are_refused(wrong):
    with pytest.raises(ConfigError, match=r"outside|snake"):
        ReachEnv(**wrong)


def test_path_with_too_few_steps_is_refused():
    with pytest.raises(ConfigError, match="steps = 10 is less than 64"):
        TrackEnv(steps=10)


def test_path_on_which_the_unloaded_robot_snaps_is_rejected():
    env = TrackEnv(robot="three_tubes", load=0.0)
    joints = np.zeros((402, env.action_space.shape[0]))
    joints[:, env.task.bodies.slides] = env.task.bodies.draw_pose(np.random.default_rng(0))[env.task.bodies.slides]
    turning = np.flatnonzero(~env.task.bodies.slides)[0]
    joints[200:, turning] = 1.0  # a jump like that of a snap
    assert env.task._path(joints) is None


def test_sampled_actions_equal_those_of_a_gymnasium_box_bit_for_bit():
    ours, theirs = Actions(3), Box(-1.0, 1.0, (3,), dtype=np.float64)
    assert ours == theirs
    for space in (ours, theirs):
        space.seed(5)
    for _ in range(100):
        drawn = ours.sample()
        assert np.array_equal(drawn, theirs.sample())
        assert drawn in theirs
    again = pickle.loads(pickle.dumps(ours))
    assert np.array_equal(again.sample(), ours.sample())
    with pytest.raises(gymnasium.error.Error, match="mask"):
        ours.sample(mask=np.ones(3))


@pytest.mark.parametrize("reward", ["sparse", "dense"])
def test_reward_is_computed_for_one_goal_and_for_many(reward):
    env = ReachEnv(reward=reward)
    random = np.random.default_rng(0)
    tips = random.uniform(-1.0, 1.0, (4, 5, 3))
    goals = tips + random.uniform(-1e-3, 1e-3, (4, 5, 3))
    away = np.linalg.norm(tips - goals, axis=-1)
    expected = np.where(away <= 1e-3, 0.0, -1.0) if reward == "sparse" else -1e3 * away
    assert len(set(expected.ravel())) > 1
    assert env.compute_reward(tips, goals, {}) == pytest.approx(expected)
    assert float(env.compute_reward(tips[0, 0], goals[0, 0], {})) == pytest.approx(expected[0, 0])
    assert np.ndim(env.compute_reward(tips[0, 0], goals[0, 0], {})) == 0
