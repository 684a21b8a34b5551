"""The result of the gate as JUnit XML, which systems of continuous integration show."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from robotctl.fleet.gate import GateReport, cause_of
from robotctl.printable import printable


def junit_text(report: GateReport) -> str:
    """Return the report: a test case for each recording, a failure for each that closes the gate.

    What could not be judged is an error, what is being written is skipped; what was accepted
    passes, with the reason.
    """
    failures, unknown = report.failures(), report.unknown()
    suite = ElementTree.Element(
        "testsuite",
        name="robotctl gate",
        tests=str(len(report.results) + len(report.lost) + len(report.live)),
        failures=str(len(failures)),
        errors=str(len(unknown) + len(report.lost)),
        skipped=str(len(report.live)),
    )

    def case_of(path: Path) -> ElementTree.Element:
        name = printable(path.name)
        return ElementTree.SubElement(suite, "testcase", classname="recording", name=name)

    for path, result in report.results.items():
        case = case_of(path)
        if path in failures or path in unknown:
            kind = "failure" if path in failures else "error"
            message = printable(cause_of(result))
            verdict = message.partition(":")[0]
            note = ElementTree.SubElement(case, kind, type=verdict, message=message)
            note.text = printable(result.says)
        elif path in report.accepted:
            by = report.accepted[path]
            out = ElementTree.SubElement(case, "system-out")
            out.text = printable(f"accepted by {by.by} at {by.at}: {by.why}")
    for path, said in report.lost.items():
        ElementTree.SubElement(case_of(path), "error", type="lost", message=printable(said))
    for path in report.live:
        ElementTree.SubElement(case_of(path), "skipped", message="it is being written")
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
