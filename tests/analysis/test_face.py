import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path

from feel321 import analysis, results, types

HEAVY = ("pandas", "scipy", "matplotlib", "statsmodels", "jinja2", "joblib", "soxr")


def test_every_name_of_the_face_is_there() -> None:
    assert all(hasattr(analysis, name) for name in analysis.__all__)


def test_import_loads_nothing_heavy() -> None:
    code = f"import sys, feel321.analysis; print([name for name in {HEAVY} if name in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_a_name_loads_its_own_module_only() -> None:
    code = "import sys; from feel321.analysis import intraclass; print(*sys.modules)"
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True).split()
    assert "feel321.analysis.agreement" in loaded
    assert not {"feel321.analysis.report.write", "feel321.analysis.mixed.model"} & set(loaded)
    code = "import sys, feel321.analysis; print(*sys.modules)"
    bare = subprocess.check_output([sys.executable, "-c", code], text=True).split()
    assert not {"numpy", "feel321.analysis.agreement"} & set(bare)


def test_no_module_hides_a_name_of_the_face() -> None:
    # Importing such a module would set it in the place of the function.
    modules = {path.stem for path in Path(str(analysis.__file__)).parent.iterdir()}
    assert modules & set(analysis.__all__) == set()


def test_what_public_functions_take_and_give_is_public() -> None:
    for name in analysis.__all__:
        thing = getattr(analysis, name)
        if not inspect.isfunction(thing):
            continue
        tree = ast.parse(Path(inspect.getfile(thing)).read_text(encoding="utf-8"))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        own = {
            alias.name
            for node in imports
            if str(node.module).startswith("feel321.analysis")
            for alias in node.names
        }
        named = {
            word
            for text in thing.__annotations__.values()
            for word in re.findall(r"[A-Za-z_]\w*", str(text))
        }
        assert own & named <= set(analysis.__all__) | set(results.__all__) | set(vars(types)), name


def test_what_the_verbs_about_methods_do_can_be_called_from_python() -> None:
    assert {"advise_tradeoff", "measure_tradeoff", "write_report"} < set(analysis.__all__)
