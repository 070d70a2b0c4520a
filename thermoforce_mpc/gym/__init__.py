"""Gymnasium environments over the plants of this package (extra `[gym]`).

Importing this package registers `thermoforce_mpc/Building-v0`:

```python
import gymnasium
import thermoforce_mpc.gym

env = gymnasium.make("thermoforce_mpc/Building-v0", testcase="house:5rooms", max_episode_length=7 * 86400)
```
"""

from __future__ import annotations

from importlib.util import find_spec

from thermoforce_mpc.errors import ConfigError

if find_spec("gymnasium") is None:
    raise ConfigError("thermoforce_mpc.gym needs Gymnasium: pip install 'thermoforce-mpc[gym]'")

from gymnasium.envs.registration import register

from thermoforce_mpc.registry import check_nothing_hides_us

check_nothing_hides_us()

from thermoforce_mpc.gym.model_env import ModelVectorEnv  # noqa: E402 - it needs what may be hidden
from thermoforce_mpc.gym.policy import observe, save, spec_of  # noqa: E402

ID = "thermoforce_mpc/Building-v0"
register(id=ID, entry_point="thermoforce_mpc.gym.making:building")

__all__ = ["ID", "ModelVectorEnv", "observe", "save", "spec_of"]
