"""kickbench: a declarative benchmark suite for symmetry-aware humanoid reinforcement learning."""

__version__ = "0.1.0"
