# SPDX-License-Identifier: GPL-3.0-or-later
"""The site that `make site` builds (tools/website).  The build itself runs where the generator is: `make test-site`."""
from __future__ import annotations

import importlib
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
WEBSITE = ROOT / "tools" / "website"
INDEX = {"version": "v1", "blocklist": [], "data": [
    {"archive_url": f"./fastgs_blender-0.1.0-{name}.zip", "archive_size": 121_600_000, "platforms": [name.partition("-python")[0]],
     "blender_version_min": "4.2.0"} for name in ("linux-x64", "linux-x64-python3.14", "windows-x64", "macos-arm64")]}
"""As Blender's server-generate writes it, without what the site does not read."""


def tool(name: str):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(WEBSITE)
        return importlib.import_module(name)


@pytest.fixture(scope="module")
def build():
    return tool("build")


@pytest.fixture(scope="module")
def hooks():
    return tool("hooks")


@pytest.fixture(scope="module")
def staged(build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    build.stage(folder)
    return folder


def test_every_page_is_in_the_navigation():
    named = re.findall(r"- (?:[^:\n]+: )?(\S+\.md)$", (WEBSITE / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    ours = {page.relative_to(ROOT).as_posix() for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]}
    assert set(named) == ours and len(named) == len(ours)


def test_what_pages_link_to_comes_along(staged):
    pages = sorted(staged.rglob("*.md"))
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8")) if "://" not in link]
    assert len(links) > 100 and not [(page.name, link) for page, link in links if not (page.parent / link).exists()]
    for page in pages:  # as they are
        assert page.read_bytes() == (ROOT / page.relative_to(staged)).read_bytes()


def test_the_gallery_has_its_pictures(hooks):
    for name in hooks.ENTRIES:
        moving, still = (Image.open(ROOT / "docs" / "gallery" / f"{name}{end}.webp") for end in ("", "-still"))
        assert moving.size == still.size == (400, 300) and moving.n_frames > 20 and moving.info["loop"] == 0, name
        assert Path(moving.filename).stat().st_size < 700_000, name


def test_the_first_page_begins_as_readme_does(hooks):
    first = hooks.FIRST.fullmatch((ROOT / "README.md").read_text("utf-8"))
    assert first["title"] == "FAST-GS for Blender" and first["src"] == "docs/first-light.webp" and len(first["lead"]) < 80
    assert first["rest"].count("## ") > 5


def test_zips_are_offered_as_links_that_blender_understands(hooks, tmp_path):
    index = tmp_path / "index.json"
    assert not any(system["zips"] for system in hooks.systems(index))
    index.write_text(json.dumps(INDEX), "utf-8")
    zips = {system["name"]: system["zips"] for system in hooks.systems(index)}
    assert zips["macOS, Intel"] == []
    assert zips["Windows"] == [{
        "link": "./fastgs_blender-0.1.0-windows-x64.zip?repository=.%2Findex.json&blender_version_min=4.2.0&platforms=windows-x64",
        "blender": "4.2 or newer", "megabytes": 122}]
    assert [each["blender"] for each in zips["Linux"]] == ["4.2 or newer", "with Python 3.14"]


@pytest.mark.parametrize(("github", "ours"), [
    ("1. One\n   more\n\n   * two\n     more\n\n   Then.\n2. Three", "1. One\n    more\n\n    * two\n        more\n\n    Then.\n2. Three"),
    ("Words:\n* one\n* two", "Words:\n\n* one\n* two"),
    ("* a\n\n  ```\n  * code\n    x\n  ```\n\nText\n    code", "* a\n\n    ```\n    * code\n      x\n    ```\n\nText\n    code"),
    ("| `a\\|b` | c \\| d |", "| `a|b` | c \\| d |"),
], ids=["nested", "after a paragraph", "code", "bars in cells"])
def test_lists_and_cells_read_as_on_github(hooks, github, ours):
    assert hooks.reindented(github) == ours


def test_the_theme_asks_no_other_host():
    for path in (WEBSITE / "theme").rglob("*.*"):
        text = path.read_text("utf-8").replace('xmlns="http://www.w3.org/2000/svg"', "")
        assert "://" not in text and "url(//" not in text, path.name


class Read(HTMLParser):
    """What a page loads, and where its links lead."""

    def __init__(self, text: str):
        super().__init__()
        self.loads, self.links, self.ids = [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.ids |= {found[key] for key in ("id", "name") if found.get(key)}
        named = [part.split()[0] for key in ("src", "href", "srcset") for part in (found.get(key) or "").split(",") if part.strip()]
        (self.links if tag == "a" or found.get("rel") in ("canonical", "prev", "next") else self.loads).extend(named)


@pytest.fixture(scope="module")
def site(build, staged, tmp_path_factory):
    """The site beside a repository's index, as it is published."""
    pytest.importorskip("mkdocs", reason="the site's generator is not installed; `make test-site` has it")
    out = tmp_path_factory.mktemp("dist")
    (out / "index.json").write_text(json.dumps(INDEX), "utf-8")
    (staged / "play").mkdir()
    for name in ("dancer", "robot"):
        (staged / "play" / f"{name}.html").write_text("<title>in the place of a page of MB</title>" + 1_200_000 * " ", "utf-8")
    build.generate(staged, out.parent / "site", out)
    build.publish(out.parent / "site", out)
    return out


def test_the_site_is_whole_and_asks_no_other_host(site):
    pages = {path: Read(path.read_text("utf-8")) for path in site.rglob("*.html") if path.name != "404.html"}
    assert {path.relative_to(site).as_posix() for path in pages} >= {"index.html", "docs/index.html", "docs/guide.html", "CHANGELOG.html"}
    for path, page in pages.items():
        for load in page.loads:
            assert "//" not in load and (path.parent / re.split("[?#]", load)[0]).is_file(), (path.name, load)
        for link in (link for link in page.links if "://" not in link and not link.startswith("mailto:")):
            where, _, part = link.partition("#")
            there = Path(os.path.normpath(path.parent / where.split("?")[0])) if where else path
            if there.suffix == ".zip":
                continue
            assert there.is_file(), (path.name, link)
            assert not part or there not in pages or unquote(part) in pages[there].ids | {"__tabbed_1_1"}, (path.name, link)


def test_the_first_page_has_it_all(site):
    text = (site / "index.html").read_text("utf-8")
    for part in ('class="stage"', 'src="play/dancer.html#play=1"', 'class="card"', 'href="play/robot.html"', "1.2 MB", 'href="index.json"',
                 "platforms=windows-x64", 'id="install-it-in-blender"', "guide.html"):
        assert part in text, part
    assert text.count("first-light.webp") <= 1  # README's picture is the stage's


def test_the_document_about_pages_lists_those_of_the_gallery(site, hooks):
    text = (site / "docs" / "web.html").read_text("utf-8")
    links = [link for link in Read(text).links if "play/" in link]
    assert links == ["../play/dancer.html", "../play/robot.html"] and hooks.PLAYED not in text


def test_search_finds_words_of_the_guide(site):
    index = json.loads((site / "search" / "search_index.js").read_text("utf-8").removeprefix("var __index = "))
    assert any("docs/guide.html" in entry["location"] and "Loop Fade" in entry["text"] for entry in index["docs"])


def test_a_broken_link_fails(build, staged, site, tmp_path):
    for broken in ("[x](nowhere.md)", "[x](guide.md#no-such-heading)"):
        page = staged / "docs" / "farms.md"
        kept = page.read_text("utf-8")
        page.write_text(f"{kept}\n{broken}\n", "utf-8")
        try:
            with pytest.raises(SystemExit, match=r"farms\.md"):
                build.generate(staged, tmp_path / "site", tmp_path)
        finally:
            page.write_text(kept, "utf-8")
