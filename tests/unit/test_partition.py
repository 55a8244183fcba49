"""Where grains lie in memory and how they are shared out among threads."""

import numpy as np
import pytest

from stickslip.core.dynamics import driver
from stickslip.core.dynamics.moving import balance_threads, split_layers
from stickslip.core.progress import cpu_quota


@pytest.mark.parametrize(
    ("spent", "bounds"),
    [
        ((70, 70), (0, 5, 10)),
        ((50, 75), (0, 6, 10)),  # the second core is a third slower
        ((1, 1000), (0, 9, 10)),
        ((1000, 1), (0, 1, 10)),
    ],
)
def test_a_slower_core_gets_fewer_tiles_but_never_none(spent, bounds):
    assert tuple(balance_threads(np.array([0, 5, 10]), np.array(spent))) == bounds


def test_tiles_stay_where_they_are_without_a_clock_or_before_the_first_step():
    share = np.array([0, 3, 7, 9])
    assert balance_threads(share, np.zeros(3, np.int64)) is share


def test_sharing_out_again_settles_where_all_take_as_long():
    speed, share = np.array([3.0, 1.0, 2.0, 2.0]), np.array([0, 40, 80, 120, 160])
    for _ in range(3):
        share = balance_threads(share, np.diff(share) / speed)
    assert np.array_equal(np.diff(share), [60, 20, 40, 40])


@pytest.mark.parametrize("tiles", [4, 5, 12, 100])
def test_no_thread_is_ever_left_without_a_tile(tiles):
    rng, share = np.random.default_rng(tiles), np.array([0, 1, 2, 3, tiles])
    for _ in range(200):
        share = balance_threads(share, rng.choice([1, 10, 1000, 10**6], 4))
        assert (np.diff(share) >= 1).all()
        assert (share[0], share[-1]) == (0, tiles)


@pytest.mark.parametrize("parts", [1, 3, 10])
def test_parts_hold_every_point_once_and_are_of_a_size(parts):
    x = np.random.default_rng(parts).random((3, 500)) * np.array([[4.0], [1.0], [1.0]])
    layers = split_layers(x, np.arange(500), parts)
    assert np.array_equal(np.sort(np.concatenate(layers)), np.arange(500))
    assert max(map(len, layers)) - min(map(len, layers)) <= 4


@pytest.mark.parametrize(
    ("groups", "files", "quota"),
    [
        ("0::/job/step\n", {"job/cpu.max": "150000 100000\n", "job/step/cpu.max": "max 100000\n"}, 1.5),
        ("0::/\n", {"cpu.max": "200000 100000\n"}, 2.0),
        ("0::/\n", {}, np.inf),
        (
            "5:cpuset:/a\n4:cpu,cpuacct:/docker/b\n0::/\n",  # the container does not have this path
            {"cpu,cpuacct/cpu.cfs_quota_us": "50000\n", "cpu,cpuacct/cpu.cfs_period_us": "100000\n"}, 0.5,
        ),
        (
            "4:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, np.inf,
        ),
    ],
)  # fmt: skip
def test_a_quota_of_processor_time_limits_the_cores(tmp_path, groups, files, quota):
    (tmp_path / "groups").write_text(groups)
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert cpu_quota(tmp_path / "groups", tmp_path) == quota


@pytest.mark.parametrize(("asked", "cores", "threads"), [("", 3, 3), ("2", 3, 2), ("8", 3, 3), ("x", 3, 3)])
def test_threads_are_at_most_the_cores_of_this_process(asked, cores, threads, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    monkeypatch.setattr(driver, "available_cores", lambda: cores)
    assert driver.available_threads() == threads
