from asgi_browser import AsgiBrowser
from made_receipts import a_receipt
from visits import COMPLETED, QUEUED, RUNNING, sign_in
from vitac.server.receipts.receipt import Receipt


def test_everybody_finds_the_key_and_how_to_check(browser: AsgiBrowser) -> None:
    html = browser.get("/receipts").text
    receipt = a_receipt()
    assert f"--key {receipt.public_key}" in html
    assert receipt.parsed_proofs()[0].checkpoint.root.hex() in html
    assert ">ants.example<" in html
    assert 'href="/receipts"' in browser.get("/").text


def test_a_team_gets_the_receipt_of_its_final_result(browser: AsgiBrowser) -> None:
    assert browser.get(f"/submissions/{COMPLETED.id}/receipt.json").status_code == 303
    sign_in(browser, "Gelbots")
    address = f"/submissions/{COMPLETED.id}/receipt.json"
    assert address in browser.get(f"/submissions/{COMPLETED.id}").text
    assert "receipt.json" not in browser.get(f"/submissions/{RUNNING.id}").text
    answer = browser.get(address)
    assert answer.headers["Content-Disposition"] == 'attachment; filename="receipt-1.json"'
    Receipt.model_validate_json(answer.text).require_valid(a_receipt().public_key)
    assert browser.get(f"/submissions/{QUEUED.id}/receipt.json").status_code == 404, "of another team"
