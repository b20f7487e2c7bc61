"""The contract of every engine as a class of tests, for pytest.

A file of tests takes it with the name under which the engine is installed::

    from backends.contract_suite import EngineContract

    class TestMine(EngineContract):
        backend = "mine"
"""

import pytest

for part in ("copies", "life", "parameters"):
    pytest.register_assert_rewrite(f"{__name__}.{part}")  # a failed assert then shows its values

from backends.contract_suite.engine import EngineContract  # noqa: E402 (only then it is rewritten)

__all__ = ["EngineContract"]
