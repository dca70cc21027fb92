"""Metadata of a recording."""

from hypothesis import given
from hypothesis import strategies as st

from station.recording.metadata import channel_texts, channels_of, texts, values_of, versions

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_metadata_values_of_a_recording_are_read_back_unchanged(values):
    assert values_of(texts(values)) == values


def test_a_metadata_value_that_is_a_text_is_stored_unchanged():
    assert texts({"source": '[cases.one]\ntitle = "x"\n', "number": "12", "seed": 3}) == {
        "source": '[cases.one]\ntitle = "x"\n',
        "number": '"12"',
        "seed": "3",
    }


def test_channels_in_the_metadata_are_read_back_in_order(channels):
    assert channels_of(channel_texts(channels.all)) == channels.all


def test_versions_in_the_metadata_are_those_of_the_running_packages():
    import numpy as np

    assert versions()["numpy"] == np.__version__
    assert versions()["ctr-station"]
