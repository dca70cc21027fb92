"""What a recording says about itself."""

from hypothesis import given
from hypothesis import strategies as st

from station.recording.metadata import channel_texts, channels_of, texts, values_of, versions

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_every_value_comes_back_as_it_was(values):
    assert values_of(texts(values)) == values


def test_a_plain_text_stays_legible():
    assert texts({"source": '[cases.one]\ntitle = "x"\n', "number": "12", "seed": 3}) == {
        "source": '[cases.one]\ntitle = "x"\n',
        "number": '"12"',
        "seed": "3",
    }


def test_channels_come_back_in_their_order(channels):
    assert channels_of(channel_texts(channels.all)) == channels.all


def test_versions_are_those_that_run():
    import numpy as np

    assert versions()["numpy"] == np.__version__
    assert versions()["ctr-station"]
