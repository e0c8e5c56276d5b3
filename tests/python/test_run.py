"""Simulated runs, step by step."""

import numpy as np
import pytest

import pb3dp
from conftest import ROOT

# Without images a run is fast.
QUICK = {"estimator.method": "geometric", "estimator.compare": []}


def test_the_hand_follows_a_target_that_is_pushed():
    with pb3dp.Run("sim", settings={**QUICK, "experiment.target": "pushed"}, stop_after_s=8.0) as run:
        assert run.method == "geometric" and run.control_period_s == pytest.approx(0.01)
        steps = [run.step() for _ in range(300)]
        before = steps[-1]
        assert before.state == "tracking" and before.number == 299
        run.push_target(x_m=0.05)
        after = [run.step() for _ in range(300)][-1]
    target = after.world_from_target[:3, 3] - before.world_from_target[:3, 3]
    hand = after.world_from_hand[:3, 3] - before.world_from_hand[:3, 3]
    assert np.linalg.norm(target) == pytest.approx(0.05, abs=1e-3)
    assert np.allclose(hand, target, atol=0.005)


def test_the_caller_moves_the_goal_and_the_share_of_the_speed():
    def hand(moved):
        with pb3dp.Run("sim", settings={**QUICK, "experiment.target": "pushed"}, stop_after_s=7.0) as run:
            steps = [run.step() for _ in range(300)]
            moved(run)
            steps += [run.step() for _ in range(300)]
        return steps[299].world_from_hand, steps[-1].world_from_hand

    shifted = np.eye(4)
    shifted[2, 3] = -0.03
    start, moved = hand(lambda run: run.shift_hand(shifted))
    assert np.allclose(np.linalg.inv(start) @ moved, shifted, atol=0.004)

    def still(run):
        run.set_speed_share(0.0)
        run.push_target(x_m=0.05)

    start, unmoved = hand(still)
    assert np.allclose(start, unmoved, atol=1e-3)


def test_one_seed_gives_one_run():
    def joints(seed):
        with pb3dp.Run("sim", settings=QUICK, seed=seed, stop_after_s=2.0) as run:
            return np.array([step.joints_rad(0) for step in run])

    first = joints(3)
    assert first.shape == (201, 7)
    assert np.array_equal(first, joints(3)) and not np.array_equal(first, joints(4))


def test_a_run_ends_when_it_is_closed_or_forgotten():
    run = pb3dp.Run("sim", settings=QUICK)
    assert run.step().number == 0
    run.close()
    assert run.step() is None and list(run) == []
    run.close()
    for _ in range(3):
        pb3dp.Run("sim", settings=QUICK).step()


def test_nothing_outside_of_this_process_can_be_reached():
    with pytest.raises(pb3dp.Error, match="here only simulated"):
        pb3dp.Run(ROOT / "configs/rig.toml")


def test_wrong_arguments():
    for call, words in [
        (lambda: pb3dp.Run("sim", settings={"scene.target": "cat"}), "scene.target"),
        (lambda: pb3dp.Run("sim", settings={"scene.nothing": 1}), "scene.nothing"),
        (lambda: pb3dp.Run([]), "config is empty"),
        (lambda: pb3dp.Run("sim", stop_after_s=float("nan")), "stop_after_s"),
    ]:
        with pytest.raises(pb3dp.Error, match=words):
            call()
    with pb3dp.Run("sim", settings=QUICK) as run:
        with pytest.raises(pb3dp.Error, match="experiment.target"):
            run.push_target(x_m=0.01)
        with pytest.raises(pb3dp.Error, match="finite"):
            run.push_target(x_m=float("nan"))
        with pytest.raises(pb3dp.Error, match="speed_share is 2"):
            run.set_speed_share(2.0)
        with pytest.raises(pb3dp.Error, match="hand_from_hand_shifted"):
            run.shift_hand(np.zeros((4, 4)))
        with pytest.raises(IndexError):
            run.step().joints_rad(2)
