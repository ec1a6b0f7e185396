"""One script per question, one folder per kind of question: README.md lists them.

Scripts are run by their path; each puts the repository's root on the import path, and so
comes here.  The motions and cases of the tests are imported from here on as ``helpers``.
"""

import sys
from pathlib import Path

sys.path.insert(1, str(Path(__file__).resolve().parents[1] / "tests"))
