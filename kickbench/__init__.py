"""kickbench: a declarative benchmark suite for symmetry-aware humanoid reinforcement learning."""

import os

# Before torch loads libgomp, which reads it once. Threads that wait for work would otherwise spin on cores that
# another process, or the physics, could use: beside three busy processes an update of the K1's networks then takes
# several times as long. Passive waiting costs an idle machine 5 to 8 % of a K1 iteration; a bounded spin
# (GOMP_SPINCOUNT=1000) costs it 1 %, but makes updates 1.4 times as long on a busy one. `kickbench doctor` prints it.
if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
