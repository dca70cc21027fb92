"""Gymnasium's own checks, and that one environment and many show the same."""

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
from core.robot.limits import TubeOrder
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.gym.actions import Actions
from station.gym.bodies import Bodies, Setting
from station.gym.environments import ReachEnv, ReachVectorEnv, TrackEnv, TrackVectorEnv

NAMES = ("station.gym:CtrReach-v0", "station.gym:CtrTrack-v0")
HIDDEN = {"load": 0.3, "tube_error": 0.1}


def same(one, other) -> bool:
    """Whether observations are equal to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)
    return np.array_equal(one, other)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("exact", [False, True])
def test_gymnasium_finds_nothing_to_blame(name, exact):
    station.gym.register()  # a second time: nothing happens
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(different from|flatten|render mode).*")
        check_env(gymnasium.make(name, exact=exact, render_mode="rgb_array", **HIDDEN).unwrapped)


@pytest.mark.parametrize("make", [ReachEnv, TrackEnv])
def test_a_seed_tells_the_whole_episode(make):
    def episode(seed):
        env = make(**HIDDEN)
        random = np.random.default_rng(seed)
        seen = [env.reset(seed=seed)[0]]
        seen += [env.step(random.uniform(-1.0, 1.0, 3))[0] for _ in range(20)]
        return seen

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
def test_many_environments_at_once_are_so_many_single_ones(many, one, more):
    """Also where episodes end and begin anew."""
    vector = many(num_envs=4, max_episode_steps=6, **more)
    singles = SyncVectorEnv([lambda: gymnasium.wrappers.TimeLimit(one(**more), 6)] * 4)
    assert same(vector.reset(seed=5)[0], singles.reset(seed=5)[0])
    vector.action_space.seed(0)
    for _ in range(15):
        actions = vector.action_space.sample()
        (seen, reward, over, cut, more_), (s, r, o, c, m) = vector.step(actions), singles.step(actions)
        assert same(seen, s)
        for ours, theirs in ((reward, r), (over, o), (cut, c)):
            assert np.array_equal(ours, theirs)
        for key, told in m.items():
            if key.startswith("_"):
                assert np.array_equal(more_[key], told)
            else:
                assert np.array_equal(more_[key][m[f"_{key}"]], told[m[f"_{key}"]])
    singles.close()


@pytest.mark.parametrize("robot", ["paper", "three_tubes"])
def test_joints_keep_their_travel_and_tubes_their_order(robot):
    file = load_robot(robot)
    bodies, limits = Bodies(Setting(robot=robot, load=0.0, period=1.0), 8), file.limits()
    random = np.random.default_rng(0)
    for row in range(8):
        bodies.put(row, bodies.robot, bodies.drawn_pose(random)[None], np.zeros(6))
    ends = np.zeros((8, bodies.lower.size), bool)
    ways = random.choice([-1.0, 1.0], ends.shape)
    for _ in range(40):
        bodies.move(7.0 * ways)
        for joints in bodies.joints:
            limits.check(joints)
            bodies.robot.check_pose(joints)
        ends |= (bodies.joints == bodies.lower) | (bodies.joints == bodies.upper)
    assert ends[:, ~bodies.slides].all()
    assert robot != "paper" or ends.all()
    assert np.abs(bodies.stride - limits.speed).max() == 0.0


def test_the_preset_of_three_tubes_has_an_order_to_keep():
    assert any(isinstance(limit, TubeOrder) for limit in load_robot("three_tubes").limits().others)


def test_rewards_of_many_are_those_of_each():
    random = np.random.default_rng(0)
    tips, goals = random.uniform(-0.1, 0.1, (2, 50, 3))
    goals[:20] = tips[:20] + random.uniform(-8e-4, 8e-4, (20, 3))
    for reward in ("sparse", "dense"):
        env = ReachEnv(reward=reward)
        together = env.compute_reward(tips, goals, {})
        alone = [env.compute_reward(tip, goal, {}) for tip, goal in zip(tips, goals, strict=True)]
        assert together.tolist() == alone
    assert set(ReachEnv().compute_reward(tips, goals, {}).tolist()) == {-1.0, 0.0}


def test_the_reward_of_a_step_is_that_of_what_it_shows():
    env = ReachEnv(**HIDDEN)
    env.reset(seed=0)
    for _ in range(5):
        seen, reward, _, _, more = env.step(env.action_space.sample())
        assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], more)
        assert more["is_success"] == (reward == 0.0)


@pytest.mark.parametrize("exact", [False, True])
def test_the_tip_is_the_loaded_robots(exact):
    """With its own tubes, and the load that nobody is told of."""
    env = ReachEnv(exact=exact, **HIDDEN)
    env.reset(seed=3)
    for _ in range(10):
        seen = env.step(np.array([1.0, -0.5, 0.3]))[0]
    bodies = env.task.bodies
    model = (ExactRod if exact else Statics)(bodies.robots[0])
    tip = model.solve(bodies.joints[0], bodies.wrenches[0]).tip
    assert np.linalg.norm(seen["achieved_goal"] - tip) < 1e-8
    described = Statics(bodies.robot).solve(bodies.joints[0], np.zeros(6)).tip
    assert np.linalg.norm(tip - described) > 1e-3


def test_who_goes_where_the_goal_was_drawn_has_reached_it():
    env = ReachEnv(**HIDDEN)
    env.reset(seed=0)
    bodies, random = env.task.bodies, np.random.default_rng(0)
    poses = np.array([bodies.drawn_pose(random) for _ in range(2)])
    env.task.goals[0] = bodies.put(0, bodies.robots[0], poses, bodies.wrenches[0])[1]
    for _ in range(400):
        _, reward, _, _, _ = env.step((poses[1] - bodies.joints[0]) / bodies.stride)
    assert reward == 0.0


def test_a_path_is_followed_exactly_without_load_by_who_knows_its_joints():
    env = TrackEnv(load=0.0, steps=100)
    task = env.task
    drawn = []
    keep = task._drawn_joints
    task._drawn_joints = lambda random: drawn.append(keep(random)) or drawn[-1]
    env.reset(seed=0)
    for step in range(1, 100):
        _, reward, _, _, more = env.step((drawn[-1][step] - task.bodies.joints[0]) / task.bodies.stride)
        assert reward > -1e-3
        assert more["error"] < 1e-6


def test_the_load_of_a_path_comes_unannounced_and_stays():
    env = TrackEnv(load=0.3)
    env.reset(seed=1)
    forces = []
    for _ in range(400):
        env.step(np.zeros(3))
        forces.append(np.linalg.norm(env.task.bodies.wrenches[0]))
    assert forces[0] == 0.0
    assert forces[-1] == np.linalg.norm(env.task.loads[0]) > 0.0
    assert np.all(np.diff(forces) >= 0.0)


def test_a_picture_shows_the_robot():
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
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(ConfigError, match=r"outside|snake"):
        ReachEnv(**wrong)


def test_a_path_of_few_steps_is_refused():
    with pytest.raises(ConfigError, match="steps = 10 are fewer than 64"):
        TrackEnv(steps=10)


def test_a_path_on_which_the_described_robot_snaps_is_no_path():
    env = TrackEnv(robot="three_tubes", load=0.0)
    joints = np.zeros((402, env.action_space.shape[0]))
    joints[:, env.task.bodies.slides] = env.task.bodies.drawn_pose(np.random.default_rng(0))[env.task.bodies.slides]
    turning = np.flatnonzero(~env.task.bodies.slides)[0]
    joints[200:, turning] = 1.0  # a jump as a snap would make it
    assert env.task._path(joints) is None


def test_actions_are_drawn_as_gymnasium_draws_them_to_the_last_bit():
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
def test_a_reward_is_that_of_one_pair_or_of_many(reward):
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
