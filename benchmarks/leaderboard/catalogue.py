"""The sequences of the leaderboard: where their owners publish them, and what others reached.

The sequences are not ours to give away.  `fetch.py` gets them from the addresses below.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sequence:
    """A sequence, as its owner publishes it and as the leaderboard takes it.

    Attributes
    ----------
    repository, commit : str
        Of GitHub.  The commit is the only checksum that is known of the originals: the listing of
        its files has the Git SHA-1 of each, and a file that differs from its own is refused.
    pattern : str
        Regular expression of the paths of the frames, which are taken in their natural order.
    files : int
        How many paths the pattern has to match.
    licence, credit : str
    first : str
        Path of a file that comes before those of the pattern.
    every : int
        Only every so many-th file is taken.
    rest : str
        Path of the rest pose, where its owner publishes one.
    vertices : int, optional
        Only so many vertices are kept, from the first.
    weld : bool
        Whether vertices that coincide in every frame become one.
    fps : float
    poses : bool
        Whether the frames have no order in time, so that STED has its spatial part only.
    neutral : bool
        Whether the first frame is the rest pose, and not one of the frames.
    millimetres : float, optional
        Length of a unit, where it is known.
    diagonal : float, optional
        Of the published rest pose's bounding box, by which the published figures are divided.
    sha256 : str, optional
        Of the converted vertices, (F, V, 3) float32 in C order, that the tables are of.
    """

    repository: str
    commit: str
    pattern: str
    files: int
    licence: str
    credit: str
    first: str = ""
    every: int = 1
    rest: str = ""
    vertices: int | None = None
    weld: bool = False
    fps: float = 24.0
    poses: bool = False
    neutral: bool = False
    millimetres: float | None = None
    diagonal: float | None = None
    sha256: str | None = None


RESEARCH = "none stated for the data: research only, not to be given on (MIT is of the code)"
CRAGL = {
    "repository": "CraGL/Hyperspectral-Inverse-Skinning",
    "commit": "c9ae7ad0b7cbab3c8c4cbdbe42fc179de545e0d5",
    "licence": RESEARCH,
}
SUMNER = "Sumner and Popović 2004; rescaled by Liu et al."
COMPSKIN = {
    "repository": "facebookresearch/compskin",
    "commit": "22e6f5fa19e533d84916bb1abd9dc88c4ac3054e",
    "licence": "Apache-2.0",
    "credit": "Kavan, Doublestein, Prazak, Cioffi and Roble 2024 (Meta)",
    "files": 1,
    "poses": True,
    "neutral": True,
    "millimetres": 10.0,
}
# Diagonals: of the rest poses fitted to Le's own models, which lie within 0.3 % of the originals';
# fetch.py takes those of the originals.
SEQUENCES = {
    "cat_poses": Sequence(
        **CRAGL, pattern=r"models/cat-poses/\d+\.obj", files=9, rest="models/cat-poses.obj",
        credit=SUMNER, poses=True, diagonal=2.2377,
        sha256="04961514d6e7cd7d0cee6ae2eac66f3c45524d296a33a949759dbdcdec602a23",
    ),
    "horse_poses": Sequence(
        **CRAGL, pattern=r"models/horse-poses/\d+\.obj", files=10, rest="models/horse-poses.obj",
        credit=SUMNER, poses=True, diagonal=2.342,
        sha256="52ceddd5253b6014e6b049a0b2d0dbb6437c1d3d9e92055d1f5b0e979f05c56f",
    ),
    "horse_gallop": Sequence(
        **CRAGL, pattern=r"models/horse-gallop/\d+\.obj", files=48, rest="models/horse-poses.obj",
        credit=SUMNER, diagonal=2.342,
        sha256="d05d33eac8e5d68cd54ce2e72f4e55a3d2a86b52f3edaef95cf3e41de0ad85f9",
    ),
    "cow_elastic": Sequence(
        **CRAGL, pattern=r"models/pcow/\d+\.obj", files=204, weld=True, fps=30.0,
        credit="Briceño et al. 2003",
        sha256="3f306d70e2272da5960d0a06877091ca016b1045523fcc9862415e0f985ef73a",
    ),
    "samba": Sequence(
        **CRAGL, pattern=r"models/samba/mesh_\d+\.obj", files=175, every=2, fps=15.0,
        credit="Vlasic et al. 2008",
        sha256="3ef838349983f60103a06ce894213db1f3a456b983b02201b355c67a2192f528",
    ),
    "ea_bone": Sequence(
        repository="electronicarts/dem-bones", commit="09b899b4158ebb59c0c7a7f58e996eef52be77e3",
        pattern=r"data/Bone_Anim\.abc", files=1, licence="BSD-3-Clause, with a clause on marks",
        credit="Electronic Arts",
        sha256="ffe5aac615d582c576bc48bdf31d63739b3a98b5bf9a211178296f89e1ccb741",
    ),
    "ict_face_expressions": Sequence(
        repository="ICT-VGL/ICT-FaceKit", commit="da5f95a607f5e6b37755b38d3385d7f2853732e5",
        first="FaceXModel/generic_neutral_mesh.obj",
        pattern=r"FaceXModel/(?!identity|generic)\w+\.obj", files=57, vertices=11248,
        licence="MIT", credit="USC Institute for Creative Technologies", poses=True, neutral=True,
        millimetres=10.0,
        sha256="a56a54692ef1be92cd31922af7dcb2c36635b2a97773b46228e9c6e298eedfad",
    ),
    "aura": Sequence(**COMPSKIN, pattern=r"in/aura\.npz"),
    "jupiter": Sequence(**COMPSKIN, pattern=r"in/jupiter\.npz"),
    "proteus": Sequence(**COMPSKIN, pattern=r"in/proteus\.npz"),
    "bowen": Sequence(**COMPSKIN, pattern=r"in/bowen\.npz"),
    "mannequin_rumba": Sequence(  # of the race, not of the leaderboard
        repository="ipc-sim/Codim-IPC", commit="9c6cbe3a5bef09a967ca8d420056adfafdf1fc9a",
        pattern=r"Projects/FEMShell/input/Rumba_Dancing/shell\d+\.obj", files=121, every=2,
        fps=12.5, licence="Apache-2.0", credit="Li, Kaufman and Jiang 2021",
        sha256="1c5d4a7f573938b7c6224a3ef41bad74bca6a23fc9152dd6ab3942f6402331e0",
    ),
}  # fmt: skip

# Published by Liu, Tan, Deng and Gingold 2020 (results_songrun/*/compare.out of their repository),
# in their metric E · 2 / diagonal, with the published rest pose given.  Of their results, those for
# chicken, face and lion repeat the figures of cat-poses and are not usable.
HYPERSPECTRAL = {  # affine bones, dense weights
    ("cat_poses", 10): 6.575, ("cat_poses", 15): 3.087, ("cat_poses", 20): 1.452,
    ("cat_poses", 25): 0.575, ("horse_poses", 10): 6.342, ("horse_poses", 20): 1.511,
    ("horse_gallop", 10): 4.536, ("horse_gallop", 20): 1.155, ("horse_gallop", 30): 0.453,
}  # fmt: skip
LE_AFFINE = {  # Le's own program, affine bones, four influences
    ("cat_poses", 10): 7.024, ("cat_poses", 15): 4.718, ("cat_poses", 20): 3.450,
    ("cat_poses", 25): 2.631, ("horse_poses", 10): 6.661, ("horse_poses", 20): 2.826,
    ("horse_gallop", 10): 5.652, ("horse_gallop", 20): 2.801, ("horse_gallop", 30): 1.759,
}  # fmt: skip
LE_RIGID = {  # Le's own program, rigid bones, four influences
    ("cat_poses", 10): 10.92, ("cat_poses", 15): 5.94, ("cat_poses", 20): 4.35,
    ("cat_poses", 25): 3.08,
}  # fmt: skip

# Published by Kavan et al. 2024, tables 1 and 4: largest and mean error of a coordinate in
# millimetres, 40 bones, 8 influences, the neutral face as rest pose.  "compressed" has only 1,000
# transforms that are not zero, Dem Bones one for each bone and shape; the
# last of proteus has 200 bones and 32 influences.
FACES = {
    "aura": {"compressed": (5.82, 0.0384), "Dem Bones": (5.65, 0.0391)},
    "jupiter": {"compressed": (8.26, 0.0297), "Dem Bones": (7.64, 0.0263)},
    "proteus": {
        "compressed": (4.80, 0.0300),
        "Dem Bones": (6.23, 0.0305),
        "200 bones, K = 32": (0.06, 0.0147),
    },
    "bowen": {"compressed": (5.99, 0.0339), "Dem Bones": (10.75, 0.0459)},
}
