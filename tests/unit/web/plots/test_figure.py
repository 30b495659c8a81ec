from vitac.web.plots.axis import Table, element, joined


def test_attributes_and_content_are_escaped() -> None:
    made = element("text", "<b>", class_="tick", text_anchor='"', x=1.0)
    assert made == '<text class="tick" text-anchor="&#34;" x="1">&lt;b&gt;</text>'


def test_elements_stay_elements_inside_others() -> None:
    inner = joined([element("rect", width=1.256), element("rect", width=2)])
    assert element("g", inner) == '<g><rect width="1.26"></rect><rect width="2"></rect></g>'


def test_the_rows_of_a_table_are_escaped_and_made_once() -> None:
    table = Table(columns=("Team", "Rate", "Date"), rows=(("<Ants>", "50 %", "1 May"), ("Bees", "40 %", "2 May")))
    ants = '<tr><th scope="row">&lt;Ants&gt;</th><td>50 %</td><td>1 May</td></tr>\n'
    assert table.body == ants + '<tr><th scope="row">Bees</th><td>40 %</td><td>2 May</td></tr>\n'
    assert table.body is table.body
