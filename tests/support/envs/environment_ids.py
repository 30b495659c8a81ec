"""Ids of all environments."""

import pytest
import vitac.envs

ENV_IDS = sorted(vitac.envs.ENVIRONMENTS)
_SLOW = {"ViTac/SoftPlug-v1", "ViTac/CableEnd-v1"}  # an env step of a soft part takes 0.1 s
EACH_ENVIRONMENT = [pytest.param(each, marks=pytest.mark.slow if each in _SLOW else ()) for each in ENV_IDS]
"""The same as parameters of a test."""
