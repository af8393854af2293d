"""Logs of robots whose truth is known: `drive` moves a robot of known slips, `log` measures it and
writes what a robot would have logged, `robots` are those whose logs come with the project.

No command uses them. They are in the package so that whoever doubts a number of `identify` can make
the shipped logs again, or a log of a robot like their own, and compare with the truth; the tests of
identification and of witnesses do the same.
"""
