"""What a process is given before JAX is imported."""

import os

import pytest

from jaxtube.experiments import environment


@pytest.fixture
def clean(monkeypatch):
    """Leave the variables of this process as they are."""
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    return monkeypatch


def test_a_process_that_inherits_flags_has_those_of_its_parent(clean):
    clean.setenv("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=true")
    environment.compile_quickly()
    once = os.environ["XLA_FLAGS"]
    environment.compile_quickly()
    assert os.environ["XLA_FLAGS"] == once


def test_a_flag_that_was_given_comes_last(clean):
    clean.setenv("XLA_FLAGS", "--some=1")
    environment.add_xla_flags("--some=0", "--other=2")
    assert os.environ["XLA_FLAGS"].split() == ["--some=0", "--other=2", "--some=1"]


def test_compiled_programs_are_kept_where_they_were_unless_a_home_is_given(clean, tmp_path):
    clean.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    environment.keep_compiled_programs()
    users = os.environ["JAX_COMPILATION_CACHE_DIR"]
    assert users.startswith(str(tmp_path / "users" / "jaxtube"))
    environment.keep_compiled_programs(tmp_path / "home")
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == users
    clean.delenv("JAX_COMPILATION_CACHE_DIR")
    environment.keep_compiled_programs(tmp_path / "home")
    assert os.environ["JAX_COMPILATION_CACHE_DIR"].startswith(str(tmp_path / "home"))
