"""The page of a garment without a browser: what it holds, what is refused, the command."""

import dataclasses

import numpy as np
import pytest

from docs.gallery.live.page import Take, main, write_page
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.paper.ensemble import Kernel
from helpers import live_garment as made
from helpers.page import Held
from ssdr.common.errors import InputError


def test_a_page_holds_the_motions_and_stays_small(tmp_path):
    garment, joints = made.one(made.network()), made.motion(1.0)
    size = write_page(garment, [Take("one", joints)], tmp_path / "a.html")
    page = Held((tmp_path / "a.html").read_text())
    assert size == (tmp_path / "a.html").stat().st_size
    kept = page.array(page.document["transforms"])
    np.testing.assert_allclose(kept.reshape(joints.shape), joints, atol=1e-6)
    assert page.document["garment"]["parameters"] == []
    least = write_page(garment, [Take("one", joints)], tmp_path / "b.html", max_bytes=size - 1)
    assert least < size
    assert "half precision." in (tmp_path / "b.html").read_text()
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(30, garment.subject.garment.n_vertices, 3))
    assert write_page(garment, [Take("one", joints, truth)], tmp_path / "c.html") > size
    write_page(garment, [Take("one", joints, truth)], tmp_path / "c.html", max_bytes=least + 100)
    page = Held((tmp_path / "c.html").read_text())
    assert page.document["input"] is None
    assert "the simulation is left out" in page.document["notes"][0]


def test_what_is_refused(tmp_path):
    garment, joints = made.one(made.network()), made.motion(1.0)
    path = tmp_path / "page.html"
    one = Take("one", joints)
    for takes, options, words in (
        ([], {}, "takes"),
        ([one], {"max_bytes": 1000}, "max_bytes"),
        ([dataclasses.replace(one, joints=joints[:, :3])], {}, "joints"),
        ([dataclasses.replace(one, joints=np.nan * joints)], {}, "NaN"),
        ([dataclasses.replace(one, truth=joints)], {}, "truth"),
    ):
        with pytest.raises(InputError, match=words):
            write_page(garment, takes, path, **options)
    networks = made.network(seed=1), made.network(seed=2)
    several = Checkpoint(networks, (P(bending=0.2), P(bending=2.0)), Kernel())
    with pytest.raises(InputError, match="ensemble"):
        write_page(several, [one], path)
    assert not path.exists()


def test_the_script(tmp_path, capsys, monkeypatch):
    page, file = tmp_path / "page.html", tmp_path / "motion.npz"
    model = made.saved(tmp_path / "one.safetensors", condition=True)
    np.savez(file, joints=made.motion(1.0))
    words = ["page.py", str(model), str(file), "-o", str(page), "--bending", "1.5"]
    monkeypatch.setattr("sys.argv", words)
    main()
    assert "1 motion(s)" in capsys.readouterr().out
    held = Held(page.read_text()).document
    assert [(c["name"], c["stop"]) for c in held["clips"]] == [("motion", 30)]
    assert held["garment"]["parameters"][0]["value"] == 1.5
