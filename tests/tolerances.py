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

# Polytopes, relative to the size of the set
SET_RELATIVE = 1e-11  # support numbers, vertices, volumes
SET_CHEBYSHEV = 1e-8  # radii, found by a linear program; support numbers of unbounded sets
SET_DECIDED = 1e-7  # margin below which an oracle does not decide emptiness or membership
SET_NEAR_DUPLICATE = 1e-9  # merged points and rows
SET_SAME_POINT = 1e-8  # distance below which brute force takes two vertices for one

# Controllers, closed loops and design.
CLOSED_LOOP = 1e-12  # float64 sums in another order, over one step or over a batch of other size
WORLD_FRAME = 1e-8  # 300 steps against an integrator run at 1e-12
EXACT_SOLVER = (
    1e-6  # first inputs of the batched solver, residual 1e-8, against an active-set method
)
SINGLE_PRECISION = 1e-4  # the same in float32
KKT = 1e-8
SINGLE_KKT = 2e-5  # the same in float32
LINEAR_PROGRAM = 1e-6  # what a linear program answers, against its own tolerance of 1e-7
INSIDE_TUBE = -1e-12  # least facet margin of a deviation or disturbance
AT_A_VERTEX = 1e-8  # relative; a disturbance of 3 mm rebuilt from errors of order one

# Quadratic programs (test_qp.py)
QP_ORACLE = 1e-9  # feasibility asked of the exact solver
QP_SHARE = 0.999  # of the feasible instances solved, and of the infeasible ones proved
QP_RESIDUAL = 1e-8
QP_ANSWER = 1e-6
QP_ROUNDING = 1e-11
QP_EDGE = (
    1e-5  # relative distance from the edge of the feasible set at which both sides are told apart
)
QP_POLISHED = 0.9  # of the constrained instances, made exact by Newton steps after ADMM
QP_SHARE_FLOAT32 = 0.9
QP_ANSWER_FLOAT32 = 1e-4
QP_ILL_CONDITIONED_FLOAT32 = 1e-3  # condition number 1e4, answers up to 30

# sets/tubes.py
TUBE_ROUNDING = 1e-12
TUBE_HALF_WIDTH = 0.5e-6  # m; the reference half widths are printed to six decimals
TUBE_HALF_WIDTH_DEG = 0.5e-5  # and to five in degrees
TUBE_VOLUME = 0.5e-9  # the reference volumes are printed to five digits
TUBE_GAIN_REACH = 0.5e-4  # m/s; printed to four decimals
LONG_TUBE = 0.5e-3  # m; printed to three decimals

# sets/invariant.py, relative
SUPPORT_PROGRAM = 1e-8  # linear programs against their answer in exact arithmetic
MAXIMAL_SET = 1e-6  # the set is built for a disturbance wider by as much
CLOSED_FORM = 1e-9

# sets/certificate.py
CERTIFICATE_MARGIN = 1e-9  # support numbers of polytopes against their vertices
PRUNED_REACH = 1e-10  # relative; extreme directions are found after a joggle of 1e-11

# jaxtube/experiments/figures.py
DRAWN = 1e-9  # what is drawn against its source: a change of units

# jaxtube/intervals.py
SHARE_BOUND = 1e-10  # relative; bounds of a share against roots in many digits
SHARE_COVERAGE = 1e-12  # exact sums of binomial probabilities
SUM_OF_LAPS = 1e-3  # relative; widths of 1e-12 around means of order one

# jaxtube/sensitivity.py
SENSITIVITY = 1e-6  # relative; derivatives against differences and against unrolled iterations
SENSITIVITY_EXCLUDED = (
    0.03  # of the solved instances: their active rows change within a difference, or are dependent
)
SENSITIVITY_FLOAT32 = 1e-2  # relative, on the worst conditioned of the active rows

# jaxtube/falsification
FALSIFY_CLOSED_FORM = 1e-9  # relative; worst cases of linear loops against sums of support numbers
FALSIFY_REPLAY = 1e-9  # m and rad; laps that are played again
FALSIFY_SLOPE = 1e-6  # relative; central differences with steps of 1e-5

# jaxtube/experiments/replay.py
REPLAYED = 1e-9  # usage of a set by one lap alone against the same lap among others

# jaxtube/montecarlo.py
COUNTED = 1e-12  # beyond a facet by more is outside
COUNTED_ROUNDING = (
    1e-10  # extremes, which are sums in another order; a lap's rounding grows over its steps
)
SOLVED_ROUNDING = 1e-8  # the same where a solver of residual 1e-8 answers
PLAN_OF_ORACLE = 1e-6  # relative; plans of the batched solver against an active-set method
REACHED_FACET = 1e-9  # relative; offsets of facets against the exact reach

# sets/exact.py
EXACT_ENCLOSURE = 2.0**-76  # a few steps of the grid of 2^-80 on which enclosures are rounded
EXACT_AGAINST_FLOAT = 1e-9  # exact bounds against linear programs and vertices in float64
EXACT_PULLED_FACET = 1e-12  # the same margins in float64, where a facet moves by a millionth
EXACT_JACOBIAN = 1e-8  # central differences with steps of 1e-5
EXACT_WHEEL_TRAVEL = (
    1e-3  # m; what a period's turn, at most 0.13 rad here, adds to the way of a wheel
)
EXACT_ROUNDED_OFFSETS = 1e-14  # float64 offsets, sums of some ten terms below one

# sets/interval.py, sets/plant.py, sets/disturbance.py
INTERVAL_WIDTH = 1e-13  # of an enclosure at a point, numbers of order one
RESIDUAL_ROUNDING = 1e-12  # m and rad; residuals against differences of numbers of order one
INTEGRATED = 1e-10  # m and rad; one period against an integrator run at 1e-13
NO_CAUSE = 1e-8  # m and rad; parts whose cause is absent: the gap always accepted, a few times
W_TIGHTNESS = 0.85  # of a bound that an optimiser must reach
REFERENCE_PART = 0.02  # relative; parts are bounded within 0.05 mm

# jaxtube/imperfect.py
ARCS_OF_A_PERIOD = (
    1e-5  # m; positions while wheels change speed by 1 m/s, arcs of a sixteenth of a period
)

# sets/control_invariant.py, jaxtube/design/guarantee.py
CONTROL_INVARIANT = 1e-7  # m, rad and units of the inputs; linear programs of numbers below one
NEARBY_SEARCH = 0.02  # of the ratio; searches from different starts that end at the same optimum

# jaxtube/tuning/descent.py
ADAM_BY_HAND = 1e-13  # points of order one; the same sums in numpy
DESCENT_OPTIMUM = 1e-8  # distance to the optimum of numbers of order one
NOISY_OPTIMUM = 0.06  # distance after 400 steps under noise of deviation 0.3 in the gradient

# jaxtube/tuning/tube.py, minimal.py, caps.py
TUBE_REACH = 1e-9  # relative; sums of support numbers against vertices, of which those closer than 1e-10 are one
TUBE_BOUND = 1e-7  # relative; where the iteration for the minimal set stops, tenfold
TUBE_TIGHT = (
    1e-9  # relative; the fixed point itself, active facets found where that iteration stopped
)
TUBE_SLOPE = 1e-6  # relative to the gradient; central differences with steps of 1e-4 of a twentieth of the gains

# sets/lyapunov.py, jaxtube/tuning/gains.py, loop.py, objective.py
ACTIVE_ROW = (
    1e-8  # m, rad and units of the inputs; distance from its bound below which a row is active
)
LEAST_SLOPE = 0.01  # of the greatest of a gradient; below, rounding hides what differences tell
LEAST_TRACE = 1e-6  # relative; what a semidefinite program's answer is known to
CENTRED_SLOPE = 1e-8  # Newton decrement of the centred cost, whose objective is of order ten
SCALED_COST = 1e-9  # relative; the same cost found with other weights
CENTRED_CURVATURE = 1e-6  # relative; central differences with steps of a thousandth
GAIN_MAPS = 1e-13  # entries of order one to ten, by differences of the same
OBJECTIVE_SLOPE = (
    1e-6  # relative; central differences of fourth order, the host's parts solved again
)
SAME_WINDOWS = 1e-9  # relative and absolute; the same sets and weights, support numbers by sums and by vertices
SAME_LAPS = 1e-8  # m, rad and m/s; closed loops under windows that agree to rounding
SAME_WEIGHTS = 1e-14  # relative; weights from their Cholesky factors
SAME_VECTOR = 1e-7  # Cholesky factors of weights of condition number 1e6 and more

# jaxtube/experiments/tune_parameter_figure.py
SPREAD = 1e-9  # places of names, of order one, against a quadratic program
SLOPES_KEPT = 0.7  # of the differences, that see the same rows active at all their points
UNROLLED = 1e-6  # relative; 400 iterations of ADMM
SAME_REDUCTION = 1e-12  # relative; means of numbers of order one
SAME_STEEP = 1e-9  # relative; a difference of objectives
NO_EFFORT = 1e-11  # m, rad and m/s; what rounding makes of zero in 40 steps, and the least root
SAME_TERMINAL_ROWS = 1e-9  # of rows of unit offset
SAME_TERMINAL_SET = 1e-8  # relative, for gains a ten-thousandth apart: what is of second order
NO_PRODUCT = 1e-15  # of rows and generators, below which its sign is rounding
