import signal
import subprocess
import sys

import pytest
from vitac.cli.service.stop_request import StopRequest


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_a_request_to_stop(number: signal.Signals) -> None:
    with StopRequest().listening() as stop:
        assert not stop.wait(0)
        signal.raise_signal(number)
        assert stop.wait(0)
        assert stop.received


def test_handlers_are_restored() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with StopRequest().listening():
        assert signal.getsignal(signal.SIGTERM) != before
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_second_signal_ends_the_process() -> None:
    code = (
        "import signal\n"
        "from vitac.cli.service.stop_request import StopRequest\n"
        "with StopRequest().listening():\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "    print('still running', flush=True)\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "    print('not reached', flush=True)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (-signal.SIGTERM, "still running\n")
