"""Check how a recording begins and ends: its first entries, proofs of snapshots, loss ledger.

A proof is the count of commands and the CRC of entries before a snapshot.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from robotctl.check.invariants import Invariants, unbalanced
from robotctl.check.journal import read_snapshot
from robotctl.check.report import Report
from robotctl.config import Config, flat
from robotctl.config.settings import keyed_leaves
from robotctl.kernel import constants
from robotctl.kernel.codec import Proof, Snapshot
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import Cause
from robotctl.messages import cdr
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import JournalEntry, chained, encode
from robotctl.recording.format.names import CLIP_RECORD, INFO_RECORD, OBSERVING, natural_order
from robotctl.recording.format.records import type_name_of
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.read.journal_reader import own_journal_topic
from robotctl.recording.read.messages import Message

IN_SOURCE = "a clip does not tell what was lost, its source does"
"""The reason for the unknown losses of a clip."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a recording ended, for the comparison of one topic: its losses, whether it is whole."""

    report: Report
    invariants: Invariants
    ledger: Mapping[str, int] | None
    """The counts of the topic, None if the recording was not closed."""

    is_clip: bool
    is_own: bool
    """Whether the recorder wrote the journal itself; a received journal may lag."""

    is_whole: bool
    """Whether the recording is a folder that includes the last recorded file."""

    has_begin: bool
    """Whether the journal has its first entry."""

    has_gaps: bool
    """Whether a gap in the journal or in the data may explain a difference."""

    @property
    def is_closed(self) -> bool:
        """Whether the recording is whole and was closed."""
        return self.is_whole and self.ledger is not None

    @property
    def lost(self) -> int:
        """The number of messages that were counted as not recorded."""
        ledger = self.ledger or {}
        return sum(ledger.get(count, 0) for count in ("lost", "unseen", "dropped"))

    def accuse(self, text: str) -> None:
        """Report `text` as a violation, or as a note if a gap or a divergence may explain it."""
        if self.has_gaps or self.report.divergence is not None:
            self.report.notes.append(text)
        else:
            self.invariants.violate(text)

    def lack(self, count: int, text: str) -> None:
        """Report that `count` messages are missing: a violation, unless losses may explain it."""
        if count <= self.lost:
            self.report.notes.append(f"{text}: {self.lost} were counted as lost")
        elif self.ledger is None:
            self.report.miss(f"{text}; {self.unknown_losses}")
        else:
            self.accuse(text)

    @property
    def unknown_losses(self) -> str:
        """The reason, as text, why the losses of a recording without a ledger are not known."""
        return IN_SOURCE if self.is_clip else "it was not closed, so its losses are not known"


EndingOf = Callable[[str | None], Ending]
"""A function that returns the Ending for a topic."""


class JournalEnd(NamedTuple):
    """The time of the journal's last entry: `t_ns` is steady, `log_ns` since the epoch.

    The control loop stalled for `stalled_ns` just before; `clock_changed`: the wall clock jumped.
    """

    t_ns: int
    log_ns: int
    stalled_ns: int
    clock_changed: bool


NOT_COMPARED: Final = (
    "the journal was received from the robot: not compared are parameters, statuses, calls, and "
    "what was sent after its end"
)


class JournalOrigin:
    """Finds out whether the recorder wrote the journal itself or received it from a robot."""

    def __init__(self, info: RecordingInfo, topic: str) -> None:
        """`topic` is the topic of the journal."""
        self._topic = topic
        self._noted = info.metadata.get(INFO_RECORD, {})
        self._has_own_name = topic == own_journal_topic(info)
        self._observes = self._noted.get("mode") == OBSERVING
        self._was_received: bool | None = None
        """Whether the log and publish times of the first entry differ, None before that entry."""

    @property
    def is_own(self) -> bool:
        """Whether the recorder wrote the journal itself."""
        if not self._was_received:
            return True
        return bool(self._noted) and self._has_own_name and not self._observes

    def first(self, message: Message) -> None:
        """Read the journal's first message."""
        # In its own journal, a recorder writes equal log and publish times.
        self._was_received = not self._noted or message.log_ns != message.publish_ns

    def check(self, report: Report) -> None:
        """Report what is not compared, if the journal was received from another process."""
        if self.is_own:
            return
        report.notes.append(NOT_COMPARED)
        if self._noted and not self._observes:
            report.miss("the journal of the robot that recorded is not there", is_outside=True)


def differing_parameters(noted: Mapping[str, str], params: KernelParams) -> Iterator[str]:
    """Yield a sentence for each parameter in `params` that differs from the metadata `noted`."""
    config = Config(kernel=params)
    values = flat(config)
    for key, leaf in keyed_leaves(config):
        theirs = noted.get(f"parameter.{key}")
        if leaf.path[0] == "kernel" and theirs is not None and theirs != str(values[key]):
            yield (
                f"the journal begins with {key} {values[key]}, and the metadata says {theirs[:80]}"
            )


HASHES: Final[Mapping[str, str]] = {
    constants.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    constants.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    cdr.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    cdr.ROBOT_STATUS: "61598f9d2936bf0665499ce4f458aba4b3e12ede4281ea119ca421cde9331509",
    cdr.JOURNAL_ENTRY: "8ecaa1252cd850455be383c3a05c471a0dbe13d5fc23ae327afcc626da89175a",
    "robot_controller/srv/SetMode_Event": (
        "9e6dda1519f7f4c9b7773852b8742429baebad1dde87e67dcda45a04abedc813"
    ),
    "std_srvs/srv/Trigger_Event": (
        "ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2"
    ),
    "sensor_msgs/msg/BatteryState": (
        "4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
    ),
    "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "sensor_msgs/msg/Joy": "0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5",
    "sensor_msgs/msg/Imu": "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "std_msgs/msg/Bool": "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "diagnostic_msgs/msg/DiagnosticArray": (
        "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
}
"""The hash of each type that a check reads, without `RIHS01_`."""

_HASH_KEY: Final = "topic_type_hash"


def check_types(recording: Recording, report: Report, topics: Container[str | None]) -> None:
    """Report each of `topics` whose recorded type hash is missing or not the one in HASHES."""
    for each in recording.open_files:
        for number, channel in each.index.channels.items():
            name = type_name_of(channel, each.index.schemas.get(channel.schema_id))
            type_hash, topic = channel.metadata.get(_HASH_KEY, ""), channel.topic
            if topic not in topics or not each.index.counts.get(number):
                continue
            if name not in HASHES:
                continue
            if not type_hash:
                text = f"{topic} is recorded without the definition of its type"
                report.miss(text, is_outside=True)
            elif type_hash != f"RIHS01_{HASHES[name]}" or channel.message_encoding != "cdr":
                report.miss(
                    f"{topic} is recorded with another version of {name} than the check reads"
                )


SINGLE_FILE: Final = "the journal goes on after this file, or was cut off: check the whole folder"


class RecordingEnds:
    """Checks the first and last entries of the journal, and the loss ledger of the last file."""

    def __init__(
        self,
        recording: Recording,
        info: RecordingInfo,
        report: Report,
        invariants: Invariants,
        origin: JournalOrigin,
    ) -> None:
        self.origin = origin
        self._recording = recording
        self._info = info
        self._report = report
        self._invariants = invariants
        self._is_clip = CLIP_RECORD in info.metadata
        self._first_seq = self._last_seq = -1
        self._last_snapshot = -1
        self._has_ended = False
        """Whether the daemon was ending at the last snapshot."""

        self._has_gaps = False
        self._ledger: Mapping[str, Mapping[str, int]] | None = None
        last = natural_order(recording.open_files[-1].path)
        self._goes_on = any(natural_order(Path(name)) > last for name in recording.lost_files)
        """Whether the recording continues after the last readable file."""

    @property
    def is_whole(self) -> bool:
        """Whether the recording is a folder that includes the last recorded file."""
        return self._recording.path.is_dir() and not self._goes_on

    def entry(self, seq: int) -> None:
        """Add the sequence number of a journal entry, to know the first and the last one."""
        if self._first_seq < 0:
            self._first_seq = seq
        self._last_seq = max(seq, self._last_seq)

    def begin(self, entry: JournalEntry) -> None:
        """Check that the journal begins with a new kernel and the parameters in the metadata."""
        report = self._report
        if entry.seq or not report.same_version or not self.origin.is_own:
            return
        snapshot = read_snapshot(entry)
        if not _is_beginning(snapshot):
            report.miss("its journal begins later than its kernel: the first are missing")
        if self._is_clip:
            return  # its metadata is that of its source's end: parameters were changed meanwhile
        noted = self._recording.metadata_of_file(0).get(INFO_RECORD, {})
        for sentence in differing_parameters(noted, snapshot.params):
            report.miss(sentence, is_outside=True)

    def snapshot(self, entry: JournalEntry, snapshot: Snapshot) -> int:
        """Read a snapshot; return the previous one's entry number, 0 if none or without `Proof`."""
        before = max(self._last_snapshot, 0)
        self._last_snapshot = entry.seq if snapshot.proof is not None else -1
        reported = snapshot.state.health.reported
        self._has_ended = any(cause is Cause.DAEMON_ENDS for cause, _ in reported)
        return before

    def check(self, events_before_snapshot: int) -> None:
        """Check the writer, the begin and the end of the journal, and the loss ledger.

        Only gaps reported before this call may explain a difference.
        """
        ledger = read_ledger(self._recording.metadata_of_file(-1))
        self.origin.check(self._report)
        if self.origin.is_own and self._last_snapshot >= 0:
            if self._recording.path.is_dir():
                self._check_begin(events_before_snapshot)
            self._check_end(ledger)
        self._check_ledger(ledger)
        self._has_gaps = self._report.has_gaps

    def _check_begin(self, events_before_snapshot: int) -> None:
        report = self._report
        if self._first_seq and self._info.files[0].name == f"{self._recording.path.name}_0.mcap":
            report.miss(f"its journal begins with entry {self._first_seq}: the first are missing")
        elif events_before_snapshot and not self._first_seq:
            report.miss("its journal does not begin with a snapshot")

    def _check_end(self, ledger: Mapping[str, Mapping[str, int]]) -> None:
        """Report a recording that continues after its last file."""
        recording = self._recording
        if recording.is_cut_off or recording.is_live or self._goes_on:
            return
        is_queued = any(counts.get("queued") for counts in ledger.values())
        has_ended = self._has_ended or not self._report.same_version
        if not is_queued and has_ended and self._last_snapshot == self._last_seq:
            return
        self._goes_on = True
        if recording.path.is_dir():
            why = "messages were still to be written" if is_queued else "its journal ends before"
            text = f"it was not closed, or its last file is not here, or not whole: {why}"
            self._report.miss(text, is_outside=True)
        elif not self._is_clip:
            self._report.notes.append(SINGLE_FILE)

    def _check_ledger(self, ledger: Mapping[str, Mapping[str, int]]) -> None:
        if ledger:
            for sentence in unbalanced(ledger, finished=self.is_whole):
                self._invariants.violate(sentence)
            self._ledger = ledger
        elif not self._is_clip:  # the source of a clip has it
            self._report.notes.append("it was not closed: it has no loss ledger to check")

    def ending(self, topic: str | None) -> Ending:
        """Return how the recording ended, for the comparison of `topic`; call `check` first."""
        return Ending(
            self._report,
            self._invariants,
            None if self._ledger is None else self._ledger.get(topic or "", {}),
            is_clip=self._is_clip,
            is_own=self.origin.is_own,
            is_whole=self.is_whole,
            has_begin=self._first_seq == 0,
            has_gaps=self._has_gaps,
        )


def _is_beginning(snapshot: Snapshot) -> bool:
    """Return whether the kernel had processed nothing before this snapshot."""
    state, proof = snapshot.state, snapshot.proof
    has_heard = state.health.odometry is not None or state.health.battery_level is not None
    has_run = state.tick_t_ns is not None or state.drive is not None or has_heard
    return not has_run and (proof is None or proof == Proof(commands=0, journal_crc=0))


class JournalChain:
    """The CRC of all entries, continued from one snapshot and compared at the next snapshot."""

    def __init__(self) -> None:
        self._seq = -1
        self._before: int | None = None
        """The CRC of all entries before the last one, None after a gap."""

        self._crc: int | None = None

    def add(self, seq: int, serialized: bytes) -> None:
        """Continue the CRC with the entry number `seq`."""
        self._before = self._crc if seq == self._seq + 1 else None
        self._crc = None if self._before is None else chained(serialized, self._before)
        self._seq = seq

    def is_whole(self, entry: JournalEntry, proof: Proof | None) -> bool:
        """Return whether the CRC over the entries before a snapshot equals the CRC in `proof`.

        Also return True where they cannot be compared: no `proof`, at the beginning, after a gap.
        """
        if proof is None or entry.seq != self._seq:
            return True
        known, self._crc = self._before, chained(encode(entry), proof.journal_crc)
        return known is None or known == proof.journal_crc


WITHOUT_PROOF: Final = "0.1.0"
"""The version that wrote no proofs."""

NOT_PROVED: Final = (
    f"version {WITHOUT_PROOF} did not number what it sent and wrote: not compared are commands, "
    "inputs, statuses, calls, and whether the journal is whole"
)


class SnapshotProofs:
    """Checks the `Proof` (command count and CRC) of a journal's snapshots: all have one or none."""

    def __init__(self, report: Report, chain: JournalChain, invariants: Invariants) -> None:
        self._report = report
        self._chain = chain
        self._invariants = invariants
        self._has_proofs: bool | None = None
        """Whether each snapshot must have a proof, None before the first snapshot."""

        self._is_told = False

    def check(self, entry: JournalEntry, proof: Proof | None, before: int) -> None:
        """Check the proof of the next snapshot; `before` is the `seq` of the previous snapshot."""
        if not self._chain.is_whole(entry, proof):
            self._invariants.violate(
                f"the journal was changed between its entries {before} and {entry.seq}"
            )
        has_proof = proof is not None
        if self._has_proofs is None:
            self._has_proofs = has_proof or self._report.version != WITHOUT_PROOF
            if not self._has_proofs:
                self._report.notes.append(NOT_PROVED)
        if has_proof is not self._has_proofs and not self._is_told:
            self._is_told = True
            self._tell(entry, has_proof=has_proof)

    def _tell(self, entry: JournalEntry, *, has_proof: bool) -> None:
        does = "tells" if has_proof else "does not tell"
        text = f"the snapshot in entry {entry.seq} {does} what was sent and written before it"
        if self._report.same_version:
            self._invariants.violate(text, (entry.seq, entry.t_ns))
        else:
            who = "those" if has_proof else "only those"
            self._report.miss(f"{text}: {who} of version {WITHOUT_PROOF} do not")
