from seeded_site import GELBOTS, SeededSite
from vitac.server.receipts.receipt import Receipt
from vitac.server.views.receipts import PublicLogView

WITNESS = "ants.example+3c2f3e1a+AcnL+Fw7cyTcwRcv0P3dxB0E0sH3fP3RPPyCqFqAFCzB"


def test_everybody_finds_the_key_and_how_to_check(site: SeededSite) -> None:
    visitor = site.visitor()
    log = PublicLogView.model_validate(visitor.get("/api/v1/receipts").json())
    html = visitor.get("/receipts").text
    assert f"--key {log.public_key}" in html
    assert log.root in html
    assert 'href="/receipts"' in visitor.get("/").text


def test_a_team_gets_the_receipt_of_its_final_result(site: SeededSite) -> None:
    browser, address = site.visitor(GELBOTS), f"{site.path_of('done')}/receipt.json"
    assert site.visitor().get(address).status_code == 303
    assert address in browser.get(site.path_of("done")).text
    assert "receipt.json" not in browser.get(site.path_of("runs")).text
    answer = browser.get(address)
    receipt = Receipt.model_validate_json(answer.text)
    assert answer.headers["Content-Disposition"] == f'attachment; filename="receipt-{receipt.entry.number}.json"'
    receipt.require_valid(receipt.public_key)
    assert browser.get(f"{site.path_of('sharp')}/receipt.json").status_code == 404, "of another team"
