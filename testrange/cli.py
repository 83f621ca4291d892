"""The command line: which commands there are, and how each ends. Every command imports its rooms when it runs, so that --help
takes no longer than it must.

Exit codes: 0 done; 1 the input or the campaign is at fault, one line on stderr; 2 wrong usage; 130 interrupted.
"""

import errno
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from cyclopts import App, CycloptsError

from campaign.errors import TestrangeError
from testrange.commands import campaigns, compare, family, faults, filing, pairs, study
from testrange.commands.options import fail

app = App(
    name="testrange",
    help="A virtual test range for UAV LiDAR and cameras after GB/T 41450-2022.",
    version_flags=["--version"],
    help_format="plaintext",  # Markdown help costs 40 ms of imports
    result_action="return_value",
    suppress_keyboard_interrupt=False,  # `call` says it in the same form as every other end
)
for _command in (
    campaigns.run,
    campaigns.simulate,
    campaigns.evaluate,
    campaigns.score,
    campaigns.plan,
    filing.archive,
    filing.export,
    filing.view,
    campaigns.check,
    faults.faults,
    study.study,
    family.family,
    pairs.pairs,
    compare.compare,
    campaigns.schema,
    filing.picture,
):
    app.command(_command)


def _one_line(error: BaseException) -> str:
    told = " ".join(str(error).split())[:200]
    return f"{told}; please report it, with what TESTRANGE_TRACEBACK=1 prints"


def _innermost(error: BaseException) -> str:
    """File and line of our own that was running."""
    here = Path(__file__).resolve().parent.parent
    place, trace = "testrange", error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if file.is_relative_to(here) and "site-packages" not in file.relative_to(here).parts:
            place = f"{file.relative_to(here)}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def call(arguments: Sequence[str]) -> int:
    """Runs one command line; returns its exit code."""
    try:
        result = app(list(arguments), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return fail(f"{' '.join(str(error).split())} See testrange --help.", 2)
    except TestrangeError as error:
        return fail(str(error), 1)
    except KeyboardInterrupt:
        return fail("interrupted", 130)
    except MemoryError:
        return fail("not enough memory; free some, or take smaller images, fewer targets or shorter strips", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader of stdout left; nothing more to say
        return 0
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return fail(
                f"{error.filename or 'output'}: no space left on the disk; free some or choose another place", 1
            )
        return fail(f"{error.filename or 'file'}: {error.strerror or error}", 1)
    except Exception as error:
        if os.environ.get("TESTRANGE_TRACEBACK"):
            raise
        return fail(f"{_innermost(error)}: internal error: {type(error).__name__}; {_one_line(error)}", 1)
    return result if isinstance(result, int) else 0


def main() -> None:
    """Entry point of the command `testrange`."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # what a library thinks of a value is no news to the user
    sys.exit(call(sys.argv[1:]))
