"""Laws of archives: what was written is read, everything else is a ValueError of one clause."""

import io
import pickle
import zipfile

import numpy as np
import pytest

from jaxtube.numpy_archive import read_archive


def pack(header: bytes) -> bytes:
    """Return an archive of one array with a header of one's own."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        length = len(header).to_bytes(2, "little")
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + length + header + bytes(8))
    return file.getvalue()


def test_what_was_written_is_read_to_the_bit():
    arrays = {
        "a/b": np.array([1.5, -0.0, np.nan, np.inf]),
        "c": np.array("text"),
        "d": np.arange(3),
    }
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    again = read_archive(file.getvalue())
    assert again.keys() == arrays.keys()
    for name, array in arrays.items():
        assert again[name].dtype == array.dtype and again[name].tobytes() == array.tobytes()
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }"
    assert read_archive(pack(header))["a"].tolist() == [0.0]


@pytest.mark.parametrize(
    "header",
    [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': ), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1",
        b"{'descr': '<U\x01', 'fortran_order': False, 'shape': (1,), }",
        b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**15,), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        b"[" * 20_000,
        b"__import__('os').getcwd()",
        b"",
    ],
)
def test_headers_of_no_array_are_refused(header):
    with pytest.raises(ValueError, match="is no archive of arrays"):
        read_archive(pack(header))


def test_other_files_are_refused():
    array = io.BytesIO()
    np.save(array, np.arange(3))
    member = io.BytesIO()
    with zipfile.ZipFile(member, "w") as archive:
        archive.writestr("a.txt", "text")
    for data in (b"", b"PK", b"\0" * 100, array.getvalue(), pickle.dumps([1])):
        with pytest.raises(ValueError, match="is no archive of arrays"):
            read_archive(data)
    with pytest.raises(ValueError, match="holds other files than arrays"):
        read_archive(member.getvalue())
