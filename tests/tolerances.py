"""Every tolerance the tests use, in one place."""

# Plant, references and prediction model.
ROUNDING = 1e-13  # a handful of float64 operations on numbers of order one
EXACT_ARCS = 1e-9  # closed-form arcs against an integrator run at 1e-12
SPLINE = 1e-4  # m and rad; cubic splines through a smooth path sampled each 0.1 s
PAPER_GAIN = 1e-6  # gains are quoted to six digits
LEAST_P_VALUE = 1e-4  # of a Kolmogorov-Smirnov test with a fixed seed
CORRELATION = 0.08  # over four standard deviations of the correlation of 3000 independent pairs

# sets/lmi.py
LQR_REFERENCE = 1e-6  # the reference gain is printed to six decimals
RICCATI_COST = 1e-6  # relative; semidefinite program against the Riccati solution
RICCATI_GAIN = 1e-4  # relative; the cost is flat around its best gain, so gains are known less well
GAP_LIMIT = 1e-4  # relative for traces, absolute for log det
GAP_ROUNDING = 1e-9
