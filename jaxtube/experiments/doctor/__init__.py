"""The command `doctor`: does everything that jaxtube needs work here?"""
