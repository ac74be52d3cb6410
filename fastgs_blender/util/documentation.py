# SPDX-License-Identifier: GPL-3.0-or-later
"""Where sentences send their reader for more: to a page of docs/, or to its address if this build has a website."""
WEBSITE = ""
"""The address of the site that tools/website builds.  tools/build_extension.py --website writes it into the copy that it packs."""


def page(name: str) -> str:
    """How a sentence names the page docs/NAME.md."""
    return f"{WEBSITE}docs/{name}.html" if WEBSITE else f"docs/{name}.md"
