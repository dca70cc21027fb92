"""Rejection of positions that the tip cannot have reached."""

from station.devices.jump_gate import JumpGate


def test_jump_gate_passes_a_slow_motion_and_rejects_a_jump():
    gate = JumpGate()

    assert all(gate.passes(n / 40.0, (0.3 * n, 0.0, 0.0)) for n in range(100))
    assert not gate.passes(2.5, (60.0, 0.0, 0.0))
    assert gate.passes(2.525, (30.0, 0.0, 0.0))


def test_jump_is_accepted_after_ten_consistent_frames():
    gate = JumpGate()
    gate.passes(0.0, (0.0, 0.0, 0.0))

    assert [gate.passes(n / 40.0, (100.0, 0.0, 0.0)) for n in range(1, 12)] == [False] * 9 + [True] * 2


def test_scattered_jumps_are_never_accepted():
    gate = JumpGate()
    gate.passes(0.0, (0.0, 0.0, 0.0))
    for n in range(1, 6):
        assert not gate.passes(n / 40.0, (100.0 + 80.0 * (n % 2), 0.0, 0.0))
