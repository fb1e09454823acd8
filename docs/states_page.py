"""Writes docs/states.md from the table in cell/machine/states.py: ``uv run python -m docs.states_page``."""

from __future__ import annotations

from pathlib import Path

from bus.codes import Code
from cell.machine.states import ANSWERS, COMMANDS, MODE_FROM, NEXT, PRODUCTION_ONLY, State, available

PAGE = Path(__file__).with_name("states.md")
_ALMOST_EVERYWHERE = 6
"""Commands accepted in more states than this are listed in words, because their arrows would hide the others."""


def page() -> str:
    """The page's text."""
    everywhere = [command for command, arrows in COMMANDS.items() if len(arrows) > _ALMOST_EVERYWHERE]
    return "\n".join(
        [
            "# States and commands",
            "",
            "<!-- Written by docs/states_page.py from cell/machine/states.py; do not edit. -->",
            "",
            "PackML (ISA-TR88.00.02): 17 states, 9 commands, and `pick`, a start of one cycle. States that act",
            "end by themselves, and lead where the third column says; the others wait for a command. A command",
            "that a state does not accept is refused with the reason and what is available; the same `command_id` sent",
            "twice acts once. After start-up the cell is Stopped: nothing moves until somebody commands it.",
            "",
            *_diagram(everywhere),
            "",
            *(_in_words(command) for command in everywhere),
            "",
            "| state | accepts | when done |",
            "|---|---|---|",
            *(_row(state) for state in State),
            "",
            "From Unholding the cell goes back to where the hold came from: Execute or Completing.",
            "",
            "## It stopped with something in its hand",
            "",
            "A stop and an abort leave the fingers where they are, with their force. When something may be between",
            "them in Stopped or Aborted, the state's `reason` says so, with the width, for as long as that is so, and",
            "the event `HAND_NOT_EMPTY` once. A start after a cell that was killed in a pick says that, too: the event",
            "`PICK_CUT_OFF` names the pick, and the `reason` keeps it until somebody commands. A `reset` opens",
            "such a hand before the arm moves, where it rests: as wide as the fingers came, or",
            "`hand.release_margin_m` wider than they stand; all the way when the cell was started since. Only when it",
            "is open the arm goes to the capture pose. To lay the thing down elsewhere, first `mode` Manual, below.",
            "",
            "## Beside the table",
            "",
            "These commands change no state. `cancel` ends a job that waits, or whose grasp has not begun.",
            "A `pick` or `start` with `queue` waits while the cell works. One that comes in Completing after the last",
            "result was said needs no `queue`: it begins as soon as the cell is Complete.",
            "",
            f"{_listed(ANSWERS)} answer a proposal, where a person approves motion (`execute.approve`). After its plan",
            "each cycle, a retry too, waits in Execute, in the stage `approve`, and nothing moves. What waits is",
            "published on `cycle/proposal`, and asked for there; `view/plan` shows it in 3-D.",
            "",
            "| command | does |",
            "|---|---|",
            "| `approve` | The arm moves. It names the proposal (`proposal`): nobody approves another than they saw. |",
            "| `next_grasp` | The next feasible grasp is planned, and waits; those like this one are left out. |",
            f"| `reject` | The cycle ends FAILED `{Code.REJECTED}` with the `reason`; it is not tried again. |",
            "",
            f"Without an answer for `execute.approve_s` the cycle ends `{Code.APPROVAL_TIMEOUT}`, and its `start` too.",
            "A stop, an abort, a cancelled or late job end it as ever. A hold, and a lost lease, hold it: no answer",
            "counts then, and the time goes on; after `unhold` it waits again. Every answer, who gave it, when and why",
            "is in the recording (`cycle/approve`), in the result (`approvals`) and an event. With `client` any",
            "program that may command the cell can answer; with `holder` only the lease's holder can approve.",
            "Nobody is asked about a `reset`, which moves the arm to the capture pose, about motions by hand, or about",
            "looks from other places before the plan, and the way back from them: `capture.views = 1` has none.",
            "",
            "## Mode Manual",
            "",
            "`mode` sets PackML's mode of the unit, `Production` or `Manual`; `state` says it. In Manual a person",
            "moves the arm by hand: away from an obstacle, to the capture pose, the hand open or closed. `Manual`",
            "stops an Idle or Complete cell, so that a `reset` comes before the next pick.",
            f"It can change in {', '.join(sorted(MODE_FROM))}.",
            f"{_listed(tuple(sorted(PRODUCTION_ONLY)))} are refused in Manual, and these in Production:",
            "",
            "| command | does |",
            "|---|---|",
            "| `jog` | One small straight step along an `axis` of base (`x`, `y`, `z`; `direction` 1, -1). |",
            "| `jog_home` | Slowly to the capture pose, around the known boxes, while it is sent again. |",
            "| `hand_open`, `hand_close` | The fingers open, or close on what is there. |",
            "",
            "A step is `manual.jog_m` long, and no faster than `manual.jog_m_s`. A held button sends it again and",
            "again; it is refused (`MOVING`) until the one before is over. `jog_home` ends 0.5 s after it was",
            "last sent: a held button sends it every 0.2 s. All of it is in Stopped, with the lease, through the",
            "gate and the node's guard; `stage` names it while it lasts. A motion is planned among the known",
            "boxes only: what lies on the table is for the person to see. It is refused (`COLLISION`) when it",
            "would touch a box; too near to one it may only lead away. Who jogs is an event. Who lets go, or is",
            "gone: a step is over within itself, `jog_home` within 0.5 s, and a lost lease ends both at once. A",
            "`stop`, `hold`, `suspend` or `abort` ends the motion, and the mode: it is Production again.",
            "",
        ]
    )


def _diagram(left_out: list[str]) -> list[str]:
    arrows = [f"    {source} --> {target} : {command}" for command, way in COMMANDS.items() if command not in left_out
              for source, target in way.items()]  # fmt: skip
    ends = [f"    {source} --> {target}" for source, target in NEXT.items()]
    return ["```mermaid", "stateDiagram-v2", "    [*] --> Stopped", *arrows, *ends, "```"]


def _in_words(command: str) -> str:
    refused = [str(state) for state in State if state not in COMMANDS[command]]
    (target,) = set(COMMANDS[command].values())
    return f"- `{command}` leads to {target} from everywhere but {', '.join(refused)}."


def _listed(commands: tuple[str, ...]) -> str:
    *others, last = (f"`{command}`" for command in commands)
    return f"{', '.join(others)} and {last}"


def _row(state: State) -> str:
    accepts = " ".join(f"`{command}`" for command in available(state)) or "-"
    return f"| {state} | {accepts} | {NEXT.get(state, 'waits')} |"


if __name__ == "__main__":
    PAGE.write_text(page())
