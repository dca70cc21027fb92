"""Escaping of the data in the player's page."""

import json

import pytest

from station.report.player import script_data


@pytest.mark.parametrize("text", ["</script><script>alert(1)</script>", "<!--<script>", "</SCRIPT >", "]]>", "\\"])
def test_script_data_of_the_player_cannot_end_or_start_a_script(text: str) -> None:
    data = script_data({"cases": [{text: text}]})
    assert "<" not in data
    assert json.loads(data) == {"cases": [{text: text}]}
