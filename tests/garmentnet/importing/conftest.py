"""Files of a cloth and of the rig that moved it."""

import pytest

import ssdr
from helpers.walking_rig import cloth, rig


@pytest.fixture
def pair(tmp_path):
    """Save a cloth and a rig under a name; their paths."""

    def save(name="walk", new_cloth=None, new_rig=None, cloth_as="usda", rig_as="glb"):
        paths = tmp_path / f"{name}.{cloth_as}", tmp_path / f"{name}.{rig_as}"
        for path, model in zip(paths, (new_cloth or cloth(), new_rig or rig()), strict=True):
            ssdr.save(model, path)
        return paths

    return save


@pytest.fixture
def files(pair):
    """A cloth as USD and its rig as glTF."""
    return pair()
