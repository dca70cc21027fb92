"""What is put into the player's page cannot break out of its place."""

import json

import pytest

from station.report.player import script_data


@pytest.mark.parametrize("text", ["</script><script>alert(1)</script>", "<!--<script>", "</SCRIPT >", "]]>", "\\"])
def test_no_text_ends_its_script_or_begins_another(text: str) -> None:
    data = script_data({"cases": [{text: text}]})
    assert "<" not in data
    assert json.loads(data) == {"cases": [{text: text}]}
