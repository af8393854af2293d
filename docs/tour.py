# %% [markdown]
# # A tour of jaxtube
#
# From a scenario to a certified controller, its simulation, a bound on how often it fails, the
# worst case, and gains tuned by gradient. Run it as a script, or cell by cell.

# %%
import jaxtube as jt
import sets

# %% [markdown]
# ## Design
#
# A scenario names the robot, its slip, its path and its limits. A design is everything computed off
# line: the set W that holds every disturbance of the slipping robot, gains, tubes, a terminal set,
# the condensed QPs, and a certificate with two verdicts, one for the linear model with w in W and
# one for the robot itself.

# %%
scenario = jt.load("certified", ["reference.duration_s=6"])
design = jt.design(scenario)
print(design)
certificate = design.certificate
print(certificate.holds_for_model, certificate.holds_for_robot)
print(certificate.table())
print(*certificate.assumptions, sep="\n")

# %% [markdown]
# The sets are polytopes; everything about them is a support number. Beside the tube of the design,
# its own invariant set can be computed again from the loops of the gain.

# %%
omega = design.terminal.invariant
loops = design.terminal.gains.loops
again = sets.maximal_rpi(loops, design.terminal.admissible, design.problem.disturbance_set)
print(f"terminal set: {len(omega.offsets)} facets, volume {omega.volume():.3g}")
print(f"largest invariant set: {len(again.polytope.offsets)} facets")

# %% [markdown]
# ## Simulate
#
# An own controller is a function u = f(errors, reference wheels) on a batch of measured errors.
# This one is the tube's gain at the centre of the speed range, without prediction. Where it is a
# function with a name, results carry that name.

# %%
K = design.tube_gain.nominal
mine = jt.simulate(design, lambda errors, wheels: errors @ K.T, laps=64)
tube_mpc = jt.simulate(design, "tube_mpc", laps=64)
print(mine)
print(tube_mpc)

# %% [markdown]
# ## How often does it fail?
#
# Every period of every lap is checked against W, E, U, the wheels and the tube. The bound is exact
# (Clopper-Pearson) and holds for the sampling law that the result names, for no other.

# %%
run = jt.montecarlo(design, laps=4096)
print(run)
print(run.share("e_outside_E"))

# %% [markdown]
# ## The worst case, by gradient

# %%
worst = jt.falsify(design, target="error", seconds=5)
print(worst)

# %% [markdown]
# ## Tune the gains
#
# By gradients through whole laps and through the tube; every iterate is designed and certified.
# Errors count once a lap has settled, after 10 s; of these laps of 6 s only the last step does.

# %%
tuned = jt.tune(scenario, variables="gains", evaluations=3, laps=8, held_out=8)
print(tuned)

# %% [markdown]
# ## Save, and read back
#
# A result replaces a saved one of its kind, and nothing else.

# %%
folder = jt.save(design, "runs/tour")
same = jt.read(folder)
print(same.certificate.verdict)
