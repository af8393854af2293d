"""Laws of laps that are kept: they come back as they were, and what plays them loses little."""

import base64

import jax.numpy as jnp
import numpy as np
import pytest
from invented_laps import LIMITS, invent_laps

from jaxtube.plant.error_dynamics import world_pose
from jaxtube.reporting import laps as kept_laps
from jaxtube.reporting.player import MISSING, choose_laps, make_player, quantise


def decode(packed, laps, channels):
    """Return values from the text that a page holds, as its script reads them."""
    whole = np.frombuffer(base64.b64decode(packed["data"]), "<i2").reshape(-1, laps, channels)
    return np.where(whole == MISSING, np.nan, whole * np.array(packed["step"]))


def test_laps_come_back_from_their_file(tmp_path):
    stored = invent_laps()
    np.savez(tmp_path / kept_laps.FILE, allow_pickle=False, **stored.arrays())
    back = kept_laps.read(tmp_path)
    assert back.period_s == stored.period_s and back.track_m == stored.track_m
    assert np.array_equal(back.reference_poses, stored.reference_poses)
    assert list(back.laps) == list(stored.laps)
    for name, kept in stored.laps.items():
        for field, value in kept._asdict().items():
            assert np.array_equal(getattr(back.laps[name], field), value), field


def test_poses_are_those_of_the_robot():
    stored = invent_laps()
    errors = stored.laps["tube_mpc"].errors.astype(float)
    wanted = world_pose(jnp.asarray(errors), jnp.asarray(stored.reference_poses[:, None]))
    np.testing.assert_allclose(stored.poses("tube_mpc"), wanted, atol=1e-12)


def test_median_worst_and_numbers_find_their_laps():
    kept = invent_laps(count=5).laps["uncompensated"]
    assert kept.find("worst") == 4 and kept.find("median") == 2
    assert kept.find("11") == 1
    for unknown in ("9", "best", "-1", "1.5", ""):
        with pytest.raises(ValueError, match="give one of 10, 11, 12, 13, 14"):
            kept.find(unknown)


def test_a_lap_that_is_no_number_is_the_worst():
    kept = invent_laps().laps["tube_mpc"]
    errors = kept.errors.copy()
    errors[7, 1, 2] = np.nan
    assert kept._replace(errors=errors).find("worst") == 1


def test_the_player_has_errors_to_a_thousandth_of_a_percent_of_their_limit():
    stored = invent_laps()
    for entry in make_player(stored)["controllers"]:
        kept = stored.laps[entry["name"]]
        count = len(entry["numbers"])
        places = [int(np.flatnonzero(kept.numbers == number)[0]) for number in entry["numbers"]]
        back = decode(entry["errors"], count, 3)
        assert np.abs((back - kept.errors[:, places]) / LIMITS).max() < 5e-5
        wheels = decode(entry["wheels"], count, 2)
        np.testing.assert_allclose(wheels, kept.wheels[:, places], rtol=1e-4)
        usage = kept.usage[places]
        assert entry["outside"] == np.flatnonzero(usage > 1).tolist()
        assert usage[entry["worst"]] == usage.max()


def test_what_is_no_number_stays_none():
    values = np.ones((4, 2, 3), np.float32)
    values[2, 1, 0] = np.nan
    values[3, 0, 2] = np.inf
    back = decode(quantise(values), 2, 3)
    assert np.array_equal(np.isnan(back), ~np.isfinite(values))
    np.testing.assert_allclose(back[np.isfinite(values)], 1.0)


def test_median_and_worst_are_shown_however_little_room_there_is():
    stored = invent_laps(count=30, names=("uncompensated", "plain_mpc", "tube_mpc"))
    for most in (2, 5, 40):
        for name, chosen in choose_laps(stored.laps, most).items():
            kept = stored.laps[name]
            assert {kept.find("worst"), kept.find("median")} <= set(chosen)
            assert len(chosen) == min(most, 30)
            assert np.all(np.diff(chosen) > 0)


def test_controllers_on_the_same_draws_show_the_same_laps():
    stored = invent_laps(count=30)
    flipped = stored.laps["tube_mpc"].errors[:, ::-1]
    laps = stored.laps | {"tube_mpc": stored.laps["tube_mpc"]._replace(errors=flipped)}
    chosen = choose_laps(laps, 10)
    assert np.array_equal(chosen["tube_mpc"], chosen["uncompensated"])
    assert {0, 29} <= set(chosen["tube_mpc"])


def test_long_laps_of_many_controllers_stay_small():
    names = ("uncompensated", "compensated", "local_gain", "equal_gain", "plain_mpc", "tube_mpc")
    stored = invent_laps(count=30, names=names, steps=10_000)
    player = make_player(stored)
    assert sum(len(entry["errors"]["data"]) for entry in player["controllers"]) < 1.5e6
    assert player["period_s"] * (player["instants"] - 1) == pytest.approx(1000, rel=1e-3)


def test_a_plant_without_wheels_shows_none():
    stored = invent_laps(names=("tube_mpc",))
    kept = stored.laps["tube_mpc"]
    nothing = kept._replace(wheels=np.full_like(kept.wheels, np.nan))
    (entry,) = make_player(stored._replace(laps={"tube_mpc": nothing}))["controllers"]
    assert entry["wheels"] is None
