"""Run one tick or more of each feature that a motion can choose, and find functions that the rehearsal left out.

As a program it prints the functions that were compiled or loaded after the rehearsal, one a line with its feature. The
lists come from the tables and models of the product, so that a new choice is tried, too.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args, get_origin

import numpy as np

from core.compiled import PREPARED
from core.control.controller_settings import Controller
from core.control.controllers import INNER_LOOPS, STRATEGIES, PositionMode, Strategy
from core.control.null_space import OBJECTIVES
from core.control.sensors import Corrections, Sensors
from core.control.setpoint_request import SetpointRequest
from core.control.step import Sample, start_controller, step
from core.control.tip_direction import TASKS, task_selection
from core.control.trajectories import Setpoint
from core.errors import DescriptionError
from station.config.controllers import DEFAULT_CONTROLLER, ControllerFile, Present, default_controller
from station.config.motions import (
    CircleMotion,
    FollowMotion,
    ForceMotion,
    HelixMotion,
    HoldMotion,
    JointSweepMotion,
    Motion,
    Orders,
    PalpateMotion,
    SinusoidMotion,
    StepMotion,
    WaypointsMotion,
)
from station.config.regions import (
    BoxRegion,
    CapsuleRegion,
    HalfSpaceRegion,
    MeshRegion,
    RegionFile,
    SphereRegion,
    read_regions,
)
from station.control import follow
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import MotionTask, Phase, Space, StreamLimits, StreamRequest
from station.devices.interfaces import TipReading
from station.lab.virtual_bench import virtual_bench, warm_up_control
from station.service.station_file import StationFile

#: A value of each key of the controller's settings that is no choice among names. Keys without influence on the code of
#: a tick have their default.
VALUES: Mapping[str, tuple[Any, ...]] = {
    "strategy": tuple(STRATEGIES), "inner": tuple(INNER_LOOPS), "k1": (0.0,), "k2": (1.0,),
    "feedforward": (True, False), "direction_weight": (0.1,), "null_space": tuple({name: 1.0} for name in OBJECTIVES),
    "stiffness": ((800.0, 900.0, 1000.0),), "max_offset": (0.01,), "filter_bandwidth": (0.5,),
    "observer_bandwidth": (1.0,), "command_interval": (0.01,), "transport_delay": (0.006,), "sublink": (0.02,),
}  # fmt: skip
DIRECTIONS = ((0.0, 0.0, 0.0, 1.0), (1.0, 0.1, 0.0, 1.0))
#: A motion of each kind.
MOTIONS: Mapping[str, Any] = {
    "hold": HoldMotion(directions=DIRECTIONS),
    "sinusoid": SinusoidMotion(amplitude=0.001, frequency=1.0),
    "circle": CircleMotion(radius=0.001, period=4.0, directions=DIRECTIONS),
    "helix": HelixMotion(radius=0.001, pitch=0.001, turn=2.0, turns=2.0),
    "waypoints": WaypointsMotion(points=((1.0, 0.001, 0.0, 0.0),)),
    "step": StepMotion(offset=(0.001, 0.0, 0.0)),
    "follow": FollowMotion(),
    "force": ForceMotion(direction=(0.0, 0.0, 1.0), force=0.1),
    "palpate": PalpateMotion(),
    "joint_sweep": None,  # needs the name of a joint
    "csv": None,  # waypoints, after its file was read
}


class Features:
    """The features of one robot, in the pose in which its virtual lab starts."""

    def __init__(self, robot: str) -> None:
        self.rig = StationFile(robot=robot).bench()
        self.robot, self.joints = self.rig.robot, np.array(self.rig.park)
        self.statics = self.rig.control.controller.statics
        free = self.statics.solve(self.joints, np.zeros(6))
        self.tip, self.direction = free.tip.copy(), free.rotation[:, 2].copy()

    def rehearse(self) -> None:
        """Rehearse as the control process does, whose default controller controls all that the robot can."""
        rig = self.rig
        possible = [one for one in map(task_selection, TASKS) if one.rows <= len(self.robot.joints)]
        controller = replace(rig.control.controller, aim=max(possible, key=lambda one: one.rows))
        warm_up_control(rig.robot, rig.lab, rig.seed, rig.park, controller)
        follow.warm_up()  # of stations that can measure a target

    def controllers(self) -> Iterator[tuple[str, Controller]]:
        """Yield a controller for each choice of each key, alone and with the station's defaults, and their pairs."""
        joints = len(self.robot.joints)
        for name, field in ControllerFile.model_fields.items():
            if name in ("tasks", "limits", "options"):  # of installed code, whose compilation is its own affair
                continue
            kind = field.annotation
            choices = VALUES.get(name) or next(
                get_args(one) for one in (kind, *get_args(kind)) if get_origin(one) is Literal
            )
            for choice, file in product(choices, (ControllerFile(), DEFAULT_CONTROLLER)):
                if name == "task" and task_selection(choice).rows > joints:
                    continue
                yield f"{name} = {choice}", file.model_copy(update={name: choice}).controller(self.robot)
        default = DEFAULT_CONTROLLER.controller(self.robot)
        for tracker, sensors in product((True, False), repeat=2):
            present = Present(tracker, sensors)
            yield str(present), default_controller(present).controller(self.robot, present)
        for task, region in product(TASKS, self.regions()):
            if task_selection(task).rows <= joints:
                file = DEFAULT_CONTROLLER.model_copy(
                    update={"task": task, "stiffness": (800.0,) * 3, "null_space": dict.fromkeys(OBJECTIVES, 1.0)}
                )
                what = f"{task} near {region.kind} (inside: {region.inside})"
                yield what, file.controller(self.robot, regions=(region,))
        sensors = Sensors.ideal(self.robot)
        yield "calibrated", replace(default, corrections=Corrections(sensors, np.zeros(3), None))
        yield "calibrated axis", replace(default, corrections=Corrections(sensors, np.zeros(3), np.array([0.0, 0, 1])))
        yield "direction observed", replace(default, watches=True)
        for region in (None, next(self.regions())):
            near = DEFAULT_CONTROLLER.controller(self.robot, regions=() if region is None else (region,))
            for name, inner in INNER_LOOPS.items():
                yield f"custom outer loop with {name}", replace(near, strategy=Strategy(_Outer(), inner))
            yield "custom inner loop", replace(near, strategy=Strategy(PositionMode(1.0, 1.0), _inner))

    def regions(self) -> Iterator[RegionFile]:
        """Yield a region of each kind near the tip, outside and inside."""
        x, y, z = self.tip.tolist()
        ahead = (x + 0.012, y, z)
        kinds = {
            "sphere": partial(SphereRegion, centre=ahead, radius=0.009),
            "capsule": partial(CapsuleRegion, start=ahead, end=(x + 0.012, y, z + 0.1), radius=0.009),
            "box": partial(BoxRegion, centre=ahead, edges=(0.01, 0.01, 0.01)),
            "half_space": partial(HalfSpaceRegion, point=ahead, normal=(-1.0, 0.0, 0.0)),
            "mesh": partial(MeshRegion, file=str(self.mesh), position=ahead),
        }
        for region in get_args(get_args(RegionFile)[0]):
            for inside in (False, True):
                yield kinds[region.model_fields["kind"].default](name="region", inside=inside)

    mesh = Path()  #: STL of a box, which `every_feature` writes

    def ticks(self, controller: Controller) -> None:
        """Compute ticks of a controller with each motion, at rest and at top speed, with a force on the tubes."""
        n, present = len(self.robot.joints), controller.tracked
        wrenches = np.zeros((len(self.robot.tubes), 6))
        wrenches[0, :3] = 0.1, 0.05, 0.02
        sample = Sample(self.joints, np.zeros(n), wrenches, self.tip, 0.005, self.direction)
        if not present:
            sample = sample._replace(tip=None, direction=None)
        memory = start_controller(controller, sample)
        for motion in MOTIONS.values():
            if motion is None or (isinstance(motion, ForceMotion | PalpateMotion) and not _presses(controller, motion)):
                continue
            orders = Orders(motion, self.robot.robot())
            for time in (0.0, 0.5, 1.0):
                memory = step(controller, memory, sample, orders.at(time)).memory
        order = Setpoint(np.full(3, 0.01), np.full(3, 0.01))
        for sent in (controller.limits.speed, -controller.limits.speed):
            memory = step(controller, memory, sample._replace(sent=sent), order).memory
        step(controller, memory, sample._replace(tip=None, direction=None), None)

    def loop(self) -> Iterator[str]:
        """Yield after each kind of run, stream and jog of a control loop on an ideal bench."""
        tasks = [task for task in TASKS if task_selection(task).rows <= len(self.robot.joints)]
        for task in tasks:
            file = DEFAULT_CONTROLLER.model_copy(update={"task": task})
            controller = file.controller(self.robot, regions=(next(self.regions()),))
            yield from (f"{task}: {what}" for what in self._runs(controller))
        yield from self._runs(DEFAULT_CONTROLLER.controller(self.robot), tuple(MOTIONS))

    def _runs(self, controller: Controller, motions: tuple[str, ...] = ("circle",)) -> Iterator[str]:
        ideal = self.rig.lab.model_copy(update={"devices": "ideal", "cameras": {}})
        lab, devices = virtual_bench(self.robot, ideal, 0, self.joints)
        tracker = devices.tracker
        assert tracker is not None
        loop, now = ControlLoop(controller, replace(devices, tracker=_Targeted(tracker))), 0.0
        stream = None

        def tick(number: int) -> None:
            nonlocal now
            for _ in range(number):
                now = round(now + controller.period, 9)
                loop.tick(now, lab.advance(now), stream)

        def run(task: MotionTask) -> None:
            loop.start(task)
            while loop.state is State.RUNNING and loop.phase is not Phase.MOVING:
                tick(1)
            tick(20)
            assert loop.state is State.RUNNING, loop.cause
            if controller.stiffness is not None:
                loop.set_stiffness(now, (900.0, 900.0, 900.0))
                tick(5)
            loop.stop(now)
            loop.reset(now)
            tick(2)
            assert loop.state is State.READY, loop.cause

        loop.connect(now)
        tick(10)
        assert loop.state is State.READY
        for space in get_args(Space):
            if space != "direction" or controller.aim.lever > 0.0:
                size = len(self.robot.joints) if space == "joints" else 3
                loop.jog(now, space, np.full(size, 1e-4))
                tick(10)
                loop.stop(now)
                loop.reset(now)
                tick(2)
                yield f"jog of {space}"
        goal = self.joints + 1e-3
        loop.start(MotionTask(controller, Orders(HoldMotion(), self.robot.robot()), 0.0, goal, rests=False))
        while loop.state is State.RUNNING:
            tick(1)
        yield "goto"
        loop.tare(now)
        tick(5)
        yield "tare"
        for name in motions:
            motion = MOTIONS[name]
            if name == "joint_sweep":
                motion = JointSweepMotion(joint=self.robot.joints[0].name, speed=1e-3, distance=1e-3)
            if motion is not None:
                run(MotionTask(controller, Orders(motion, self.robot.robot()), 60.0))
                yield name
        pointing = None if controller.aim.lever == 0.0 else self.direction
        for position in (None, np.zeros(3)):
            stream = StreamRequest(0, SetpointRequest(position, np.full(3, 1e-4), now + 5.0, 0.1, pointing))
            run(MotionTask(controller, StreamLimits(), 60.0))
            stream = None
            yield "stream"


class _Targeted:
    """The ideal tracker, which also measures a target at a fixed offset from the tip."""

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)

    def poll(self, now: float) -> TipReading | None:
        frame = self._tracker.poll(now)
        return None if frame is None else frame._replace(target=frame.position + 0.01)


class _Outer:
    def tip_velocity(self, setpoint: Setpoint, tip: np.ndarray) -> np.ndarray:
        return PositionMode(1.0, 1.0).tip_velocity(setpoint, tip)


def _inner(u_int: np.ndarray, view: Any) -> Any:
    return INNER_LOOPS["loaded"](u_int, view)


def _presses(controller: Controller, motion: ForceMotion | PalpateMotion) -> bool:
    try:
        motion.check(controller)
    except DescriptionError:  # the controller cannot hold a force
        return False
    return True


def every_feature(robot: str, folder: Path) -> Iterator[tuple[str, str]]:
    """Yield each feature with a function that its ticks had to compile or load after the rehearsal."""
    import trimesh

    assert {one.model_fields["kind"].default for one in get_args(get_args(Motion)[0])} == set(MOTIONS)
    features = Features(robot)
    features.mesh = folder / "box.stl"
    trimesh.creation.box((10.0, 10.0, 10.0)).export(features.mesh)
    # The station process reads and checks a mesh, not the control process.
    read_regions([MeshRegion(name="checked", file=str(features.mesh))])
    features.rehearse()
    known = len(PREPARED)
    for what, controller in features.controllers():
        features.ticks(controller)
        yield from ((what, name) for name in PREPARED[known:])
        known = len(PREPARED)
    for what in features.loop():
        yield from ((what, name) for name in PREPARED[known:])
        known = len(PREPARED)


if __name__ == "__main__":
    with TemporaryDirectory() as made:
        for feature, function in every_feature(sys.argv[1], Path(made)):
            sys.stdout.write(f"{feature}: {function}\n")
