"""The experiments for a reader: each with its cases in words, or with why its file is none."""

from core.errors import CtrError
from station.config.strict import preset_names
from station.experiments.described import facts
from station.experiments.experiment import Case, offered
from station.service.bench import Bench
from station.service.fits import otherwise, refusal
from web.api.schemas import CaseOut, ExperimentOut, FactOut


def experiments_out(bench: Bench) -> list[ExperimentOut]:
    """All that a station with this bench offers; a file that is no experiment hides no other."""
    return [_experiment_out(name, bench) for name in preset_names("experiments")]


def _experiment_out(name: str, bench: Bench) -> ExperimentOut:
    try:
        experiment = offered(name)
    except CtrError as error:
        return ExperimentOut(name=name, title="", cases=(), error=str(error))
    cases = tuple(_case_out(case, experiment.title, bench) for case in experiment.cases)
    return ExperimentOut(name=experiment.name, title=experiment.title, cases=cases)


def _case_out(case: Case, title: str, bench: Bench) -> CaseOut:
    file = case.file
    # A case's own title says what it is; without one its name has to.
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
        facts=tuple(FactOut(what=fact.what, text=fact.text) for fact in facts(case)),
        warnings=(*otherwise(case, bench), *case.warnings),
        refused=refusal(case, bench),
    )
