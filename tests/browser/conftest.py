"""One browser for the whole lane, one page of each kind of run."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser.chrome import Page, browser


@pytest.fixture(scope="session")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A tab of a headless browser."""
    with browser(tmp_path_factory.mktemp("browser") / "profile") as page:
        yield page


@pytest.fixture
def page(tab: Page) -> Iterator[Page]:
    """The tab, which must have had nothing to complain of by the test's end, and asked for no file but the page."""
    tab.faults.clear()
    tab.requests.clear()
    yield tab
    assert tab.faults == []
    assert [url for url in tab.requests.values() if not url.startswith(("file:", "data:"))] == []


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where screenshots go, to be looked at: runs/browser/ of this checkout."""
    folder = Path(__file__).parents[2] / "runs" / "browser"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
