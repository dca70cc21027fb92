"""Experiments as REST responses: each with readable descriptions of its cases, or with the error of its file."""

from core.errors import CtrError
from station.config.strict import preset_names
from station.experiments.case_summary import case_facts
from station.experiments.experiment import Case, offered_experiment
from station.service.case_compatibility import deviations_from_case, incompatibility
from station.service.rig import Rig
from web.api.schemas import CaseOut, ExperimentOut, FactOut


def experiments_out(bench: Rig) -> list[ExperimentOut]:
    """Return all experiments that a station with this rig offers; an invalid file is listed with its error."""
    return [_experiment_out(name, bench) for name in preset_names("experiments")]


def _experiment_out(name: str, bench: Rig) -> ExperimentOut:
    try:
        experiment = offered_experiment(name)
    except CtrError as error:
        return ExperimentOut(name=name, title="", cases=(), error=str(error))
    cases = tuple(_case_out(case, experiment.title, bench) for case in experiment.cases)
    return ExperimentOut(name=experiment.name, title=experiment.title, cases=cases)


def _case_out(case: Case, title: str, bench: Rig) -> CaseOut:
    file = case.file
    # A case without a separate title has the experiment's title. The name of such a case is the better description.
    words = file.title if file.title != title else ", ".join(case.name.replace("_", " ").split("-"))
    return CaseOut(
        name=case.name,
        words=words,
        duration=file.duration,
        strategy=file.controller.strategy,
        trajectory=file.trajectory.kind,
        load=file.load.kind,
        robot=case.robot.name,
        lab=file.lab,
        start=file.start,
        facts=tuple(FactOut(what=fact.what, text=fact.text) for fact in case_facts(case)),
        warnings=(*deviations_from_case(case, bench), *case.warnings),
        refused=incompatibility(case, bench),
    )
