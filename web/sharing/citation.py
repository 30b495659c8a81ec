"""Texts that cite a result. Called by the page of a submission."""

from dataclasses import dataclass

from vitac.server.views.submissions import SubmissionView

_BIBTEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{character: f"\\{character}" for character in "{}%$&#_"},
    }
)
"""How characters are written that mean something to LaTeX."""


@dataclass(frozen=True, kw_only=True)
class Citation:
    """A result as it is cited.

    Attributes:
        plain: one sentence.
        bibtex: an entry of a BibTeX file.
    """

    plain: str
    bibtex: str


def cite(found: SubmissionView, track: str, address: str) -> Citation:
    """Return the texts that cite a complete submission.

    Args:
        found: the submission.
        track: title of its track.
        address: of its page.
    """
    evaluation, year = found.evaluation, found.submitted_at.year
    played = evaluation.played
    rate = f"Success rate {100 * played.success_rate:.1f} % in {', '.join(played.tasks)}, evaluator" if played else ""
    note = f"{rate or 'Evaluator'} {evaluation.evaluator_version}, result hash {evaluation.result_hash}"
    fields = {
        "title": f"{{{_escaped(found.name)}}}",
        "author": f"{{{_escaped(found.team.name)}}}",
        "year": str(year),
        "howpublished": _escaped(f"ViTac Arena, {track}"),
        "note": _escaped(note),
        "url": address,
    }
    lines = [f"  {name:<12} = {{{text}}}" for name, text in fields.items()]
    return Citation(
        plain=f"{found.team.name}. {found.name}. ViTac Arena, {track}, {year}. {note}. {address}",
        bibtex="\n".join([f"@misc{{vitac_{found.id.hex[:12]},", ",\n".join(lines), "}"]),
    )


def _escaped(text: str) -> str:
    return text.translate(_BIBTEX)
