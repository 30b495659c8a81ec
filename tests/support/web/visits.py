"""The visitors and submissions of the page tests, and how a test visits the pages."""

from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_submission, a_visitor
from page_service import SIGNER, FixedData
from vitac.server.database.states import EvaluationState, Role
from vitac.server.views.evaluations import VerdictView
from vitac.server.views.submissions import SubmissionView
from vitac.web.session import signer

GELBOTS, BEARS, ORGANIZERS = a_visitor("Gelbots"), a_visitor("Bears"), a_visitor("organizers", Role.ORGANIZER)
RUNNING = a_submission("Gelbots", EvaluationState.RUNNING, name="runs", done=137)
COMPLETED = a_submission("Gelbots", EvaluationState.COMPLETED, name="done")
BOTH = a_submission("Gelbots", EvaluationState.COMPLETED, name="both", tasks=(TASK, LOCK))
FAILED = a_submission(
    "Gelbots",
    EvaluationState.FAILED,
    name="broke",
    done=30,
    verdict=VerdictView(code="crashed", title="The policy crashed.", message="ValueError", task=LOCK, episode=4),
    log_tail="<script>alert(1)</script>",
)
QUEUED = a_submission("Bears", EvaluationState.QUEUED, name="waits", workers=0)


def sign_in(browser: AsgiBrowser, name: str, **fields: str) -> None:
    answer = browser.post("/sign-in", data={"token": f"token-of-{name}"} | fields)
    assert answer.status_code == 303


def form_token(browser: AsgiBrowser) -> str:
    return SIGNER.form_token(browser.cookies[signer.COOKIE])


def page_of(data: FixedData, browser: AsgiBrowser, submission: SubmissionView) -> str:
    data.found = [submission]
    sign_in(browser, "Gelbots")
    return browser.get(f"/submissions/{submission.id}").text.replace("\N{NO-BREAK SPACE}", " ")
