"""Looks at all outside links of the pages: their form, and with --ask whether they answer.

usage: python docs/check_links.py [--ask]
"""

import re
import sys
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

TOP = Path(__file__).parents[1]
PAGES = sorted([*TOP.glob("*.md"), *(TOP / "docs").rglob("*.md")])
LINK = re.compile(r"\]\((\w+:[^)\s]+)\)|<(\w+:[^>\s]+)>|(?<![\w(<`])(https?://[^\s)>`\"]+)")
LOCAL = ("127.0.0.1", "localhost")


def links() -> dict[str, list[str]]:
    """All outside links, with the pages that have them."""
    found: dict[str, list[str]] = {}
    for page in PAGES:
        text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.S | re.M)
        for groups in LINK.findall(text):
            link = next(one for one in groups if one).rstrip(".,;")
            found.setdefault(link, []).append(str(page.relative_to(TOP)))
    return found


def wrong_form(link: str) -> str:
    """What is wrong with a link as it is written; empty where nothing is."""
    parts = urlsplit(link)
    if parts.scheme == "mailto":
        return "" if "@" in parts.path else "no address"
    if parts.scheme != "https":
        return "not https"
    return "" if parts.hostname and "." in parts.hostname else "no host"


def no_answer(link: str) -> str:
    """Why a link does not answer; empty where it does."""
    request = urllib.request.Request(link, method="HEAD", headers={"User-Agent": "link check"})
    try:
        with urllib.request.urlopen(request, timeout=20):
            return ""
    except (urllib.error.URLError, TimeoutError) as error:
        return str(error)


def main() -> int:
    """Print what is wrong; 1 if anything is."""
    wrong = 0
    for link, pages in links().items():
        if urlsplit(link).hostname in LOCAL:
            continue
        problem = wrong_form(link) or (no_answer(link) if "--ask" in sys.argv else "")
        wrong += bool(problem)
        print(f"{problem or 'ok'}: {link} ({', '.join(pages)})")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
