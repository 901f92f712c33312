"""Rotation matrices of batched unit quaternions (w, x, y, z)."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """Rotation matrices of unit quaternions: columns are the rotated axes.

    Args:
        quaternion: Unit quaternions, w first [B, 4].

    Returns:
        Matrices R [B, 3, 3] with v_world = R v_body.
    """
    w, x, y, z = quaternion.unbind(dim=1)
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz = 2 * x * y, 2 * x * z, 2 * y * z
    wx, wy, wz = 2 * w * x, 2 * w * y, 2 * w * z
    rows = (1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy)
    return torch.stack(rows, dim=1).view(-1, 3, 3)
