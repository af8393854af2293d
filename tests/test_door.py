"""The door: every name is there, lazily, and nothing heavy is imported before it is used."""

import subprocess
import sys

import jaxtube as jt


def test_every_name_is_found_where_the_door_says():
    assert set(jt.__all__) == set(jt.HOMES) == set(dir(jt))
    for name in jt.__all__:
        assert getattr(jt, name).__name__ == name


def test_an_unknown_name_is_an_attribute_error():
    assert not hasattr(jt, "cake")


def test_importing_the_package_imports_nothing_heavy():
    heavy = "{'jax', 'numpy', 'scipy', 'matplotlib', 'sets'}"
    program = f"import sys, jaxtube; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
