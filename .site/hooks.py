"""Collect the pages of the site: guides, the API by task, notebooks as they ran, Markdown files of the repository."""

import importlib
import json
import re
import sys
from base64 import b64decode
from pathlib import Path
from typing import Any

import griffe
from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# Pages of the API: title, guide, and the modules or objects whose public names are on the page.
TASKS = [
    ("Maps and scenes", "distance_function", "geometry scenes"),
    ("Distances to a goal", "distance_function", "oracles _types"),
    ("PLRs", "distance_function", "plr _io plr._stack.evaluate"),
    ("Errors and pictures", "distance_function", "metrics plot"),
    ("Any two points", "any_two_points", "pairs plr._construct_many plr._stack"),
    ("Buildings", "buildings", "buildings pairs.building_pairs"),
    ("Inside jit", "inside_jit", "traced"),
    ("Costs and volumes", "costs_and_volumes", "eikonal spaces"),
    ("Cost distance", "cost_distance", "rasters"),
    ("Teams", "teams", "planners _problem robots _validate ompl oracles._several_goals.exact_lower_bound"),
    ("Follow the field", "follow_the_field", "_descend plr._trace"),
    ("Gradients", "gradients", "traced._polygon_distance plr._tunable"),
    ("C and JavaScript", "c_and_javascript", "plr.portable buildings.numpy_building"),
]
FIGURES = {"1": 2, "2": 4, "3": 3, "4": 2, "5": 3, "6": 2, "7": 3, "8": 3}  # the gallery's picture of each notebook
GUIDES, API, GALLERY = "plr_jax/guides/README.md", "api/README.md", "notebooks/README.md"
RESULTS = ["experiments/README.md", "experiments/paper.md"]
INTERNAL = r"_(?!_call__)|tree_|(file_bytes|has_arrays_of_file|table_class|tables_from_corner|tables_and_points)$"
INTERNAL += "|parameter_map"  # members of classes that are on no page
PROJECT = ["CHANGELOG.md", "STABILITY.md", "SECURITY.md", "CONTRIBUTING.md"]
package: Any = griffe.load("plr_jax", search_paths=[ROOT])
top = importlib.import_module("plr_jax")
modules = [name for name in top.__all__ if package[name].is_module and name != "guides"]
pages: dict[str, Any] = {}  # Markdown and files by their paths in the site
fenced = "\n```{}\n{}\n```\n".format


def guide_title(name: str) -> str:
    """Return the title of a guide."""
    return name.replace("_", " ").capitalize().replace("javascript", "JavaScript")


def docstring(name: str) -> str:
    """Return the Markdown that shows the docstring of a module without a heading."""
    return f"::: {name}\n    options: {{members: false, show_root_heading: false, show_root_toc_entry: false}}\n"


def add_guides() -> list[str]:
    """Add the guides; return the paths of all pages in their order, as the next two functions do."""
    names = re.findall(r"^- `plr_jax.guides.(\w+)`", package["guides"].docstring.value, re.MULTILINE)
    pages[GUIDES] = f"# Guides {{ #plr_jax.guides }}\n\n{docstring('plr_jax.guides')}"
    for name in names:
        text = f"# {guide_title(name)} {{ #plr_jax.guides.{name} }}\n\n{docstring(f'plr_jax.guides.{name}')}"
        pages[f"plr_jax/guides/{name}.md"] = text
    return [GUIDES, *(f"plr_jax/guides/{name}.md" for name in names)]


def members(name: str, guide: str) -> str:
    """Return the option that lists the members of a class: first those that its guide mentions, in its order."""
    found = package[name].all_members if package[name].is_class else {}
    shown = [key for key, member in found.items() if not re.match(INTERNAL, key) and member.has_docstring]
    shown.sort(key=lambda key: (not found[key].is_function, found[key].inherited))
    mentions = ["__call__", *re.findall(r"\.(\w+)", guide), *shown]
    return f"    options: {{members: {json.dumps(sorted(shown, key=mentions.index))}}}\n" if shown else ""


def add_api() -> list[str]:
    """Add the pages of the API, with each public name on one page."""
    names = [name for name in top.__all__ if not package[name].is_module] + modules
    names += [f"{module}.{name}" for module in modules for name in getattr(top, module).__all__]
    rules = {f"plr_jax.{prefix}.": title for title, _, prefixes in TASKS for prefix in prefixes.split()}
    public: dict[str, dict[str, str]] = {title: {} for title, *_ in TASKS}  # shortest public names, by their sources
    for name in names:
        source = package[name].canonical_path
        prefix = max((prefix for prefix in rules if f"{source}.".startswith(prefix)), key=len, default=None)
        if prefix is None:
            raise PluginError(f"plr_jax.{name}, of {source}, is on no page: add it to TASKS in .site/hooks.py.")
        public[rules[prefix]].setdefault(source, name)
    paths = [f"api/{title.lower().replace(' ', '_')}.md" for title in public]
    pages[API] = f"# API\n\n{docstring('plr_jax')}\n\n## Public names by task\n"
    for path, (title, guide, _) in zip(paths, TASKS, strict=True):
        pages[path] = f"# {title}\n\nGuide: `plr_jax.guides.{guide}`\n"
        pages[API] += f"\n### [{title}]({Path(path).name})\n\n"
        pages[f"plr_jax/guides/{guide}.md"] += f"\nAPI: [{title}](../../{path})\n"
        guide_text = package["guides"][guide].docstring.value
        mentions = re.findall(r"plr_jax\.([\w.]*\w)", guide_text) + names
        modules_of = {name: name.partition(".")[0] if "." in name or name in modules else "" for name in names}
        order = {
            name: (modules_of[name], name not in modules, not package[name].is_function, mentions.index(name))
            for name in names
        }
        for name in sorted(public[title].values(), key=order.get):
            pages[path] += f"\n::: plr_jax.{name}\n" + (
                "    options: {members: false}\n" if name in modules else members(name, guide_text)
            )
            about = package[name].docstring.value.partition("\n\n")[0].split()
            pages[API] += f"- `plr_jax.{name}`: {' '.join(about)}\n"
    return [API, *paths]


def add_notebooks() -> list[str]:
    """Add the notebooks with their stored outputs, and the gallery."""
    notebooks = {path.stem: json.loads(path.read_text()) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    pages[GALLERY] = '# Gallery of notebooks\n\n<div class="cards" markdown>\n'
    for name, notebook in notebooks.items():
        text, num_figures = "", 0
        for cell in notebook["cells"]:
            source = "".join(cell["source"])
            if "outputs" in cell:
                text += fenced("python", source)
            else:  # formulas are short: italics need no script
                text += "\n" + re.sub(r"\$([^$\n]+)\$", r"<i>\1</i>", source).replace(".ipynb)", ".md)") + "\n"
            for output in cell.get("outputs", []):
                data = output.get("data") or {"text/plain": output["text"]}
                html = "".join(data.get("text/html", ""))
                if "image/png" in data:
                    num_figures += 1
                    pages[f"notebooks/{name}_{num_figures}.png"] = b64decode("".join(data["image/png"]))
                    text += f"\n![Figure {num_figures}]({name}_{num_figures}.png)\n"
                else:
                    text += (
                        f"\n<div>{html}</div>\n" if "<iframe" in html else fenced("text", "".join(data["text/plain"]))
                    )
        pages[f"notebooks/{name}.md"] = text
        title, about = text.strip().removeprefix("# ").split("\n\n")[:2]
        picture = f"{name}_{min(FIGURES.get(name[0], 1), num_figures)}.png"
        card = f"[![{title}]({picture})]({name}.md)\n\n**[{title}]({name}.md)**: "
        pages[GALLERY] += f"<div markdown>\n{card}{re.split(r'(?<=[.?]) ', about)[0]}\n</div>\n"
    pages[GALLERY] += "</div>\n"
    return [GALLERY, *(f"notebooks/{name}.md" for name in notebooks)]


def add_markdown(name: str) -> None:
    """Add a Markdown file of the repository, and copies of the files to which it links."""

    def link(match: re.Match[str]) -> str:
        source = ((ROOT / name).parent / match[1]).resolve()
        path = source.relative_to(ROOT).as_posix()
        if source.is_dir():
            return f"{match[0]}/README.md"
        if source.suffix == ".md" or source.with_suffix(".md").relative_to(ROOT).as_posix() in pages:
            return match[0].replace(source.suffix, ".md")
        pages[path] = source.read_bytes()
        return match[0]

    pages[name] = re.sub(r"\]\((?!http|#)([^)#]+)", link, (ROOT / name).read_text())


def on_config(config: Any) -> None:
    """Collect all pages, and set the navigation."""
    project = [name for name in PROJECT if (ROOT / name).exists()]
    guides, api = add_guides(), add_api()
    config.nav = [{"Home": "README.md"}, {"Guides": guides}, {"API": api}, {"Notebooks": add_notebooks()}]
    config.nav += [{"Results": RESULTS}, {"Project": project}]
    for name in ["README.md", *RESULTS, *project]:
        add_markdown(name)
    config.theme.static_templates.discard("404.html")  # only for servers: its links are absolute
    for name in [*guides, *api, "CHANGELOG.md"]:
        tags = "tags: [release]\n" * (name == "CHANGELOG.md")  # words that the search ranks first
        pages[name] = f"---\nsearch: {{boost: 2}}\n{tags}---\n{pages[name]}"
    pages["README.md"] = f"---\nhide: [navigation]\n---\n{pages['README.md']}"


def on_files(files: Any, config: Any) -> None:
    """Give all pages to MkDocs."""
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))


@event_priority(100)  # before references are resolved
def on_env(env: Any, config: Any, files: Any) -> None:
    """Link names of the API in running text to their sections, also in roles such as ``:func:`construct```."""
    contents = [file.page for file in files.documentation_pages()]
    sections = {section for page in contents for section in re.findall(' id="(plr_jax[^"]*)"', page.content)}
    scope = "plr_jax"

    def link(match: re.Match[str]) -> str:
        nonlocal scope
        section, role, code = match.groups()
        scope = section or scope
        if not code:
            return match[0]
        called = code.partition("(")[0]
        name = called.removeprefix("~").removeprefix("plr_jax.")
        first, _, rest = name.partition(".")
        near = [module for module in modules if role or name[:1].isupper() or scope == f"plr_jax.{module}"]
        places = ["plr_jax", *(f"plr_jax.{module}" for module in near)]
        if role:
            places = [scope.rsplit(".", depth)[0] for depth in range(scope.count(".") + 1)] + places
            code = code.rpartition(".")[2] if code[0] == "~" else code
        found = [f"{place}.{name}" for place in places] + [f"plr_jax.{rest}"] * (first in modules)
        is_variable = code in [*modules, "guides"] or (called != code and called.islower() and "." not in called)
        section = next((place for place in found if place in sections and not is_variable), None)
        if section is None:
            return f"<code>{code}</code>"
        _, is_guide, guide = section.partition("plr_jax.guides.")
        text = guide_title(guide) if is_guide else f"<code>{code}</code>"
        return f'<autoref identifier="{section}">{text}</autoref>'

    skipped = r'<(?:pre|a|h\d)\b(?: id="(plr_jax[^"]*)")?.*?</(?:pre|a|h\d)>'
    for page in contents:
        scope = "plr_jax"
        private = r'\n[^\n]*<span class="n">_\w+</span><span class="p">:</span>[^\n]*'  # parameters in signatures
        page.content = re.sub(private, "", page.content)
        if page.file.src_uri not in RESULTS:  # there, names are those of scripts
            page.content = re.sub(rf"{skipped}|(:\w+:)?<code>([^<]+)</code>", link, page.content, flags=re.DOTALL)
