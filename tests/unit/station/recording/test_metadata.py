"""Metadata of a recording."""

from hypothesis import given
from hypothesis import strategies as st

from station.recording.data_section import RowFormat
from station.recording.metadata import channel_texts, row_format, texts, values_of

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


def test_channels_in_the_metadata_are_read_back_in_order_with_their_types(channels):
    read = row_format(channel_texts(RowFormat.compact(channels.all)))

    assert tuple(read.channels) == channels.all
    assert [kind for channel, kind in zip(read.channels, read.types, strict=True) if channel.unit == "s"] == (
        ["float64"] * len([channel for channel in channels.all if channel.unit == "s"])
    )
    assert set(read.types) == {"float64", "float32"}
