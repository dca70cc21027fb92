"""The checklist after an exchange of tubes names the procedures that must be repeated."""

from station.calibration.exchange import connection_checklist


def procedures(before, now) -> list[str]:
    return [todo.procedure for todo in connection_checklist(before, now) if todo.procedure]


def test_reinserted_tubes_need_the_procedure_tracker(paper):
    assert procedures(paper, paper) == ["tracker"]


def test_tubes_of_another_stiffness_need_the_procedure_tubes(paper):
    stiffer = paper.tubes[0].model_copy(update={"bending_stiffness": 0.05})

    assert procedures(paper, paper.model_copy(update={"tubes": (stiffer, paper.tubes[1])})) == ["tubes"]


def test_changed_stages_need_the_procedures_axes_and_latency(paper):
    coarse = paper.joints[0].model_copy(update={"microstep": 1e-5})
    other = paper.model_copy(update={"joints": (coarse, *paper.joints[1:])})

    assert procedures(paper, other) == ["axes", "latency", "tracker"]


def test_manual_tasks_precede_procedures_in_the_checklist(paper):
    todo = connection_checklist(paper, paper)

    assert [bool(each.procedure) for each in todo] == sorted(bool(each.procedure) for each in todo)
    assert "power off" in todo[0].text
