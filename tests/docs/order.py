"""The order of a message: what happened; what was expected; what to do."""

from __future__ import annotations

import re

# How an advice begins
ADVICE = (
    "(?:add|attach|begin|check|choose|clean|correct|do|end|exchange|fetch|give|go"
    "|home|keep|lay|leave|let|look|lower|make|mend|move|narrow|press|put|raise"
    "|remove|repair|run|save|seat|set|take|tighten|try|update|use|wait|watch|wire"
    "|write)\\b"
)


def out_of_order(message: str) -> bool:
    """Whether advice does not come last: also where it says what was expected, or
    two are joined by a comma."""
    text = re.sub(r"\([^()]*\)", "", message)
    if re.search(rf"[:.] {ADVICE}", text, re.IGNORECASE):
        return True
    facts, _, advice = text.rpartition("; ")
    if re.search(rf"(?:^|; ){ADVICE}", facts):
        return True
    if re.search("expected|, which is", advice) and re.match(ADVICE, advice):
        return True
    # After a condition, or one of several that may be chosen from
    is_choice = re.match("(?i)(?:if|where|for) ", advice) or ", or " in advice
    checked = facts if is_choice else text
    return bool(re.search(rf", {ADVICE}", checked))
