# Lines of earlier formats, made into records as the format of now has them.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   no number   of its printer it has the name of printer.cfg without the folder
#   2           the whole path of that; a warning is a text, and what an accuracy
#               run has found stands in the words of its verdict only
#   3           a warning says what it is about, an accuracy run what its cause is

from ..uncertainty.cycles import NO_CAUSE, SITES

# Of a line; lines of a later one are left out, and stay.
FORMAT = 3

# What a warning may be about besides one site: the height of the probe's body
BODY = "switch - nozzle"

# Until format 2: what the verdict says of a printer that is as it should be
NOTHING_TO_DO = "nothing to do"


# Changes a record of an earlier format ('number', 0: it has none), of whose fields
# nothing is known yet.
def modernize(record, number):
    if number >= 3:
        return
    if "warnings" in record:
        record["warnings"] = old_warnings(record["warnings"])
    if "cycles" in record:
        is_good = NOTHING_TO_DO in "%s" % (record.get("verdict"),)
        record["cause"] = NO_CAUSE if is_good else ""


def old_warnings(texts):
    if not isinstance(texts, list):
        return []
    texts = ["%s" % (text,) for text in texts]
    return [{"about": old_about(text), "text": text} for text in texts]


# What a text of before begins with; empty: it is about none of the touches
def old_about(text):
    for about in (BODY,) + SITES:
        if text.startswith((about + ":", about + " is")):
            return about
    return ""
