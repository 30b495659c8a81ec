from vitac.web.plots.figure import element, joined


def test_attributes_and_content_are_escaped() -> None:
    made = element("text", "<b>", class_="tick", text_anchor='"', x=1.0)
    assert made == '<text class="tick" text-anchor="&#34;" x="1">&lt;b&gt;</text>'


def test_elements_stay_elements_inside_others() -> None:
    inner = joined([element("rect", width=1.256), element("rect", width=2)])
    assert element("g", inner) == '<g><rect width="1.26"></rect><rect width="2"></rect></g>'
