"""Requirements of every figure: texts inside it and apart from each other, colours of the palette."""

from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_hex
from matplotlib.text import Text

from fastcoil.base.figures import COLOURS, LINE_GREY, SHADE_GREY

PALETTE = {to_hex(colour) for colour in (*COLOURS, LINE_GREY, SHADE_GREY, "black", "white")}


def assert_texts_fit(figure):
    """Assert that every text with letters lies within the figure and on no other."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # ticks outside of an axis, or hidden by a neighbour's, are also Texts
    extents = {
        text: text.get_window_extent(canvas.get_renderer())
        for text in figure.findobj(Text)
        if any(map(str.isalpha, text.get_text()))
    }
    extents = {text: extent for text, extent in extents.items() if extent.width > 1.0}
    assert extents
    for text, extent in extents.items():
        assert -1 <= extent.x0 < extent.x1 <= figure.bbox.x1 + 1, text
        assert -1 <= extent.y0 < extent.y1 <= figure.bbox.y1 + 1, text
    for (one, here), (other, there) in combinations(extents.items(), 2):
        assert not here.shrunk(0.98, 0.98).overlaps(there.shrunk(0.98, 0.98)), (one, other)


def assert_palette(figure):
    """Assert that lines, areas and dots have colours of the palette; maps have another scale."""
    for axes in figure.axes:
        colours = [line.get_color() for line in axes.lines]
        colours += [p.get_facecolor() if p.get_fill() else p.get_edgecolor() for p in axes.patches]
        for collection in (c for c in axes.collections if not isinstance(c, QuadMesh)):
            colours += [*collection.get_facecolor(), *collection.get_edgecolor()]
        assert {*map(to_hex, colours)} <= PALETTE
