"""Results in folders.

    result.json      what kind of result it is, its plain numbers and names, and the SHA-256 of each
                     other file and of itself
    scenario.toml    the scenario with every key spelled out
    arrays.npz       its arrays, without pickles
    reference.*, slips.*    copies of the files that the scenario names

Each file appears complete or not at all, and while they are written result.json says so: a save
that was broken off is told from a result. A folder that was moved still reads, one of whose files
any byte was changed does not.
"""

from jaxtube.storage.arrays import Arrays, flatten, nest, refuse_differences
from jaxtube.storage.reading import read_result
from jaxtube.storage.stored import FILES, StoredResult
from jaxtube.storage.writing import write_result

__all__ = [
    "FILES",
    "Arrays",
    "StoredResult",
    "flatten",
    "nest",
    "read_result",
    "refuse_differences",
    "write_result",
]
