"""Colours that colour-blind readers can distinguish (Okabe and Ito), and their meaning on the page and in figures."""

Colour = tuple[int, int, int]

BLACK: Colour = (0, 0, 0)
ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
GREEN: Colour = (0, 158, 115)
YELLOW: Colour = (240, 228, 66)
BLUE: Colour = (0, 114, 178)
VERMILLION: Colour = (213, 94, 0)
PURPLE: Colour = (204, 121, 167)
SLATE: Colour = (86, 98, 112)
STEEL: Colour = (118, 133, 150)  # this grey is visible on white and on black
GREY: Colour = (150, 158, 166)

DESIRED, MEASURED, ESTIMATED, FORCE, CONTACT = GREEN, ORANGE, BLUE, PURPLE, VERMILLION
TRUE = VERMILLION  # the true tip of a virtual lab, and its error
TARGET = YELLOW  # the moving target that the tip follows
#: Colours of the tubes, innermost first; robots with more tubes repeat these colours.
TUBES: tuple[Colour, ...] = (SKY, STEEL, YELLOW, SLATE)
#: Colours of x, y and z in plots.
AXES: tuple[Colour, ...] = (VERMILLION, GREEN, BLUE)


def css(colour: Colour) -> str:
    """Return the colour in the notation of CSS and uPlot."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def tube(number: int) -> Colour:
    """Return the colour of a tube; 0 is the innermost."""
    return TUBES[number % len(TUBES)]
