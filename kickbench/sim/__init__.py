"""Robot and task -> MjSpec -> compiled model, sensors, index maps by name; the two physics engines."""

# pyright: reportAttributeAccessIssue=false
import mujoco

# Callers look for unstable states themselves; MuJoCo would print each, and write MUJOCO_LOG.TXT.
mujoco.set_mju_user_warning(lambda message: None)
