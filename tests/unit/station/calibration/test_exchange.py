"""The checklist after an exchange of tubes."""

from station.calibration.exchange import checklist


def procedures(before, now) -> list[str]:
    return [todo.procedure for todo in checklist(before, now) if todo.procedure]


def test_the_same_tubes_taken_out_and_put_back_need_the_coil_found(paper):
    assert procedures(paper, paper) == ["tracker"]


def test_tubes_of_another_stiffness_need_everything_that_hangs_on_them(paper):
    stiffer = paper.tubes[0].model_copy(update={"bending_stiffness": 0.05})

    assert procedures(paper, paper.model_copy(update={"tubes": (stiffer, paper.tubes[1])})) == ["tubes"]


def test_other_stages_need_their_signs_and_the_latency(paper):
    coarse = paper.joints[0].model_copy(update={"microstep": 1e-5})
    other = paper.model_copy(update={"joints": (coarse, *paper.joints[1:])})

    assert procedures(paper, other) == ["axes", "latency", "tracker"]


def test_a_person_is_told_first_what_to_do_by_hand(paper):
    todo = checklist(paper, paper)

    assert [bool(each.procedure) for each in todo] == sorted(bool(each.procedure) for each in todo)
    assert "power off" in todo[0].text
