"""Rotations of batched vectors by unit quaternions (w, x, y, z)."""

from __future__ import annotations

import torch
from torch import Tensor


def rotate_inverse(quaternion: Tensor, vector: Tensor) -> Tensor:
    """Expresses a world vector in the frame of the quaternion: R^T v.

    Args:
        quaternion: Unit quaternions, w first [B, 4].
        vector: World vectors [B, 3].

    Returns:
        Vectors in the rotated frame [B, 3].
    """
    axis = -quaternion[:, 1:]
    t = 2.0 * torch.linalg.cross(axis, vector)
    return vector + quaternion[:, :1] * t + torch.linalg.cross(axis, t)
