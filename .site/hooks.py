"""Collect the pages of the site: guides, the API by task, notebooks as they ran, Markdown files of the repository."""

import importlib
import json
import re
import sys
from base64 import b64decode
from collections import defaultdict
from pathlib import Path
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# Pages of the API: title, guide, and the modules or objects whose public names are on the page.
TASKS = {
    "Maps and scenes": ("distance_function", "geometry scenes"),
    "Distances to a goal": ("distance_function", "oracles _types"),
    "PLRs": ("distance_function", "plr _io"),
    "Errors and pictures": ("distance_function", "metrics plot"),
    "Any two points": ("any_two_points", "pairs plr._construct_many plr._stack"),
    "Buildings": ("buildings", "buildings pairs.building_pairs"),
    "Inside jit": ("inside_jit", "traced"),
    "Costs and volumes": ("costs_and_volumes", "eikonal spaces"),
    "Cost distance": ("cost_distance", "rasters"),
    "Teams": ("teams", "planners _problem robots _validate ompl oracles._several_goals.exact_lower_bound"),
    "Follow the field": ("follow_the_field", "_descend plr._trace"),
    "Gradients": ("gradients", "traced._polygon_distance plr._tunable"),
    "C and JavaScript": ("c_and_javascript", "plr.portable buildings.numpy_building"),
}
PROJECT = [f"{name}.md" for name in ("CHANGELOG", "STABILITY", "SECURITY", "CONTRIBUTING") if (ROOT / f"{name}.md").exists()]
RESULTS = ["experiments/README.md", "experiments/paper.md"]
FIGURES = {"1": 2, "2": 4, "3": 3, "4": 2, "5": 3, "6": 2, "7": 3, "8": 3}  # of notebooks, for the gallery
package: Any = griffe.load("plr_jax", search_paths=[ROOT])
modules = [name for name in importlib.import_module("plr_jax").__all__ if package[name].is_module and name != "guides"]
pages: dict[str, str | bytes] = {}  # texts and pictures by their paths in the site


def outside_code(pattern: str, change: Any, text: str) -> str:
    """Replace a pattern in the parts of a Markdown text that are outside fenced code."""
    parts = re.split(r"(^```.*?^```)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(p if p.startswith("```") else re.sub(pattern, change, p, flags=re.MULTILINE) for p in parts)


def docstring(module: Any) -> str:
    """Return a module's docstring, with headings of the second level."""
    return outside_code("^#", "##", re.sub("^Guide: .", lambda begin: begin[0][-1].upper(), module.docstring.value))


def add_guides() -> list[str]:
    """Add the guides, in the order of their index; return their paths."""
    paths = ["plr_jax/guides/README.md"]
    pages[paths[0]] = f"# Guides {{ #plr_jax.guides }}\n\n{docstring(package['guides'])}"
    for name in re.findall(r"^- `plr_jax.guides.(\w+)`", package["guides"].docstring.value, re.MULTILINE):
        paths.append(f"plr_jax/guides/{name}.md")
        title = name.replace("_", " ").capitalize().replace("javascript", "JavaScript")
        pages[paths[-1]] = f"# {title} {{ #plr_jax.guides.{name} }}\n\n{docstring(package['guides'][name])}\n"
    return paths


def add_api() -> list[str]:
    """Add the pages of the API, with each public name on one page; return their paths."""
    public = [name for name in importlib.import_module("plr_jax").__all__ if not package[name].is_module] + modules
    public += [f"{module}.{name}" for module in modules for name in importlib.import_module(f"plr_jax.{module}").__all__]
    rules = {f"plr_jax.{prefix}.": title for title, (_, prefixes) in TASKS.items() for prefix in prefixes.split()}
    names: dict[str, dict[str, str]] = defaultdict(dict)  # of a page: paths in the package, shortest public names
    for name in public:
        path = package[name].canonical_path
        found = [prefix for prefix in rules if f"{path}.".startswith(prefix)]
        if not found:
            raise PluginError(f"{path} is public as plr_jax.{name}, and on no page: see TASKS in .site/hooks.py.")
        names[rules[max(found, key=len)]].setdefault(path, name)
    paths = ["api/README.md"]
    pages[paths[0]] = f"# API\n\n{docstring(package)}\n\n## Public names by task\n"
    for title, (guide, _) in TASKS.items():
        paths.append(f"api/{title.lower().replace(' ', '_')}.md")
        pages[paths[-1]] = f"# {title}\n\nGuide: `plr_jax.guides.{guide}`\n"
        pages[paths[0]] += f"\n### [{title}]({Path(paths[-1]).name})\n\n"
        pages[f"plr_jax/guides/{guide}.md"] += f"\nAPI: [{title}](../../{paths[-1]})\n"
        text = package["guides"][guide].docstring.value
        for name in sorted(names[title].values(), key=lambda name: ("." in name or name in modules, f"plr_jax.{name}" not in text, text.find(f"plr_jax.{name}"))):
            about = " ".join(package[name].docstring.value.partition("\n\n")[0].split())
            pages[paths[0]] += f"- `plr_jax.{name}`: {about}\n"
            options = "\n    options: {members: false}" if name in modules else ""
            pages[paths[-1]] += f"\n::: plr_jax.{name}{options}\n"
    return paths


def add_notebooks() -> list[str]:
    """Add the notebooks with their stored outputs, and the gallery; return their paths."""
    paths, gallery = ["notebooks/README.md"], '# Notebooks\n\n<div class="cards" markdown>\n'
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, pictures = "", []
        cells = json.loads(path.read_text())["cells"]
        for cell in cells:
            source = "".join(cell["source"]).replace(".ipynb)", ".md)")
            text += f"\n{source}\n" if cell["cell_type"] == "markdown" else f"\n```python\n{source}\n```\n"
            for output in cell.get("outputs", []):
                data = {kind: "".join(content) for kind, content in output.get("data", {}).items()}
                if "image/png" in data:
                    pictures.append(f"{path.stem}_{len(pictures) + 1}.png")
                    pages[f"notebooks/{pictures[-1]}"] = b64decode(data["image/png"])
                    text += f"\n![Figure {len(pictures)}]({pictures[-1]})\n"
                elif "text/html" in data:
                    text += f'\n<div class="output">\n{data["text/html"]}\n</div>\n'
                else:
                    text += f"\n```text\n{''.join(output.get('text', data.get('text/plain', '')))}\n```\n"
        paths.append(f"notebooks/{path.stem}.md")
        pages[paths[-1]] = text
        title, about = "".join(cells[0]["source"]).removeprefix("# ").split("\n\n")[:2]
        thumbnail = pictures[FIGURES.get(path.stem[0], 1) - 1]
        card = f"[![{title}]({thumbnail})]({path.stem}.md)\n\n**[{title}]({path.stem}.md)**: "
        gallery += f"<div markdown>\n{card}{re.split(r'(?<=[.?]) ', about)[0]}\n</div>\n"
    pages[paths[0]] = f"{gallery}</div>\n"
    return paths


def add_markdown(name: str) -> None:
    """Add a Markdown file of the repository, and copies of the files to which it links."""

    def link(match: re.Match[str]) -> str:
        label, target, anchor = match.groups()
        path = ((ROOT / name).parent / target).resolve()
        uri = path.relative_to(ROOT).as_posix().replace(".py", ".md").replace(".ipynb", ".md")
        if path.is_dir():
            target += "/README.md"
        elif uri.endswith(".md") and uri in pages:
            target = str(Path(target).with_suffix(".md"))
        elif uri not in [*PROJECT, *RESULTS]:
            pages[path.relative_to(ROOT).as_posix()] = path.read_bytes()
        return f"{label}({target}{anchor})"

    text = outside_code("^ +", lambda indent: 2 * indent[0], (ROOT / name).read_text())  # Python-Markdown nests by 4
    pages[name] = outside_code(r"(\[[^\]]*\])\((?!http|#)([^)#]+)(#?[^)]*)\)", link, text)


def on_config(config: MkDocsConfig) -> None:
    """Collect all pages, and set the navigation."""
    config.nav = [{"Home": "README.md"}, {"Guides": add_guides()}, {"API": add_api()}, {"Notebooks": add_notebooks()}]
    config.nav += [{"Results": RESULTS}, {"Project": PROJECT}]
    for name in ["README.md", *RESULTS, *PROJECT]:
        add_markdown(name)


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Give all pages to MkDocs."""
    for uri, content in pages.items():
        files.append(File.generated(config, uri, content=content))


@event_priority(100)  # before references are resolved
def on_env(env: Any, config: MkDocsConfig, files: Files) -> None:
    """Link names of the API in running text to their sections, also in roles such as ``:func:`construct```."""
    texts = [file.page for file in files.documentation_pages()]
    sections = {section for page in texts for section in re.findall(' id="(plr_jax[^"]*)"', page.content)}
    scope = ""

    def link(match: re.Match[str]) -> str:
        nonlocal scope
        section, role, code = match.groups()
        scope = section or scope
        if not code:
            return match[0]
        name = code.partition("(")[0].removeprefix("~").removeprefix("plr_jax.")
        places = [f"plr_jax.{name}", f"plr_jax.{name.partition('.')[2]}"]
        if role:
            places = [f"{scope.rsplit('.', depth)[0]}.{name}" for depth in range(scope.count(".") + 1)] + places
            places += [f"plr_jax.{module}.{name}" for module in modules]
            code = code.rpartition(".")[2] if code[0] == "~" else code
        section = next((place for place in places if place in sections and code not in modules), None)
        return f'<autoref identifier="{section}"><code>{code}</code></autoref>' if section else f"<code>{code}</code>"

    for page in texts:
        scope = ""
        skipped = r'<(?:pre|a|h\d)\b(?: id="(plr_jax[^"]*)")?.*?</(?:pre|a|h\d)>'
        page.content = re.sub(rf"{skipped}|(:\w+:)?<code>([^<]+)</code>", link, page.content, flags=re.DOTALL)
