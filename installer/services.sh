# shellcheck shell=bash
# Part of install.sh: which services are restarted, and when not.

# What a Moonraker says: the units of its Klipper and of itself, - where it does
# not know, and what that Klipper does. A klippy that has stopped with an error
# prints nothing; one that Moonraker does not see may print for somebody else.
# Where Moonraker is, there is a Python 3, but not always curl.
readonly PRINT_STATE='
import json, sys, urllib.request as request

opener = request.build_opener(request.ProxyHandler({}))

def ask(path):
    with opener.open(sys.argv[1] + path, timeout=3) as answer:
        return json.load(answer)["result"]

klippy = ask("/server/info")["klippy_state"]
state = "idle" if klippy in ("error", "shutdown") else "unknown"
if klippy == "ready":
    status = ask("/printer/objects/query?print_stats&idle_timeout")["status"]
    states = [status[name]["state"] for name in ("print_stats", "idle_timeout")]
    busy = {"printing", "paused", "Printing"}.intersection(states)
    state = "busy" if busy else "idle"
try:
    units = ask("/machine/system_info")["system_info"]["instance_ids"]
except Exception:
    units = {}
print(units.get("klipper") or "-", units.get("moonraker") or "-", state)'

has_systemd() {
    [[ ! $(systemctl is-system-running 2>/dev/null) =~ ^(offline|unknown|)$ ]]
}

# services_of KIND: klipper or moonraker, and those with a name after a dash;
# some with such names are no printers
services_of() {
    systemctl list-unit-files --no-legend --no-pager --plain "$1*.service" \
        2>/dev/null | sed -nE "s/^($1(-[0-9A-Za-z]+)?)\.service.*/\1/p" |
        grep -vE -e '-(mcu|obico|bambu|companion|hmi)$' || true
}

# One line for each Moonraker that answers, see PRINT_STATE
ask_moonrakers() {
    local conf url
    for conf in "${every_conf[@]}"; do
        url_of "$conf"
    done | sort -u | while IFS= read -r url; do
        python3 -c "$PRINT_STATE" "$url" 2>/dev/null || true
    done
}

# state_of KIND UNIT: what the printer of a unit does, or unknown. A Moonraker
# that does not know its units speaks of the only one there is.
state_of() {
    local field=1 states
    [ "$1" = klipper ] || field=2
    states=$(awk -v field="$field" -v unit="$2" '
        $field == unit { print $3 }' <<<"$answers")
    if [ -z "$states" ] && [ "$(wc -l <<<"$answers")" -eq 1 ] &&
        [ "$(active_units "$1" | wc -l)" -eq 1 ]; then
        states=$(awk -v field="$field" '$field == "-" { print $3 }' <<<"$answers")
    fi
    # Of several that mean the same unit, the one that knows of a print counts
    case $states in
        *busy*) say busy ;;
        "" | *unknown*) say unknown ;;
        *) say idle ;;
    esac
}

active_units() {
    local unit
    for unit in $(services_of "$1"); do
        ! systemctl is-active --quiet "$unit" || say "$unit"
    done
}

# url_of CONF: where its Moonraker answers
url_of() {
    local host port
    host=$(setting "$1" server host)
    port=$(setting "$1" server port)
    case $host in
        "" | 0.0.0.0 | all | ::) host=127.0.0.1 ;;
    esac
    say "http://$host:${port:-7125}"
}

restart_services() {
    local what kind
    if [ -z "$links_changed$confs_changed" ]; then
        tell "Nothing changed; nothing to restart"
        return 0
    fi
    if [ -n "$links_changed" ] && [ -n "$uninstall" ]; then
        tell "Klipper is not restarted: it does not start while printer.cfg" \
            "has a section of a removed module. Remove that, then restart it"
        links_changed=""
    fi
    what="${links_changed:+Klipper}${confs_changed:+ Moonraker}"
    [ -n "$what" ] || return 0
    what=${what# }
    if [ -z "$use_restart" ] || ! has_systemd; then
        tell_to_restart "$what"
        return 0
    fi
    # A password may take as long as a print takes to begin
    [ -n "$dry_run" ] || [ "$(id -u)" -eq 0 ] || [ ! -t 0 ] || sudo -v || true
    # Before one of them is restarted, and does not answer any more
    answers=$(ask_moonrakers)
    klippers=$(active_units klipper)
    for kind in $what; do
        restart_kind "${kind,,}"
    done
}

# tell_to_restart KINDS: the command, with those that run or the usual names
tell_to_restart() {
    local kind units command="sudo systemctl restart"
    for kind in $1; do
        units=$(active_units "${kind,,}")
        [ -n "$units" ] || units=$(services_of "${kind,,}")
        command+=" ${units:-${kind,,}}"
    done
    command=${command//$'\n'/ }
    if has_systemd; then
        tell "Services not restarted. When nothing prints: $command"
    else
        tell "Services not restarted: this machine has no systemd that answers." \
            "Restart ${1/ / and } yourself. Where there is systemd: $command"
    fi
    [[ $1 != *Klipper* ]] || {
        not_restarted=1
        tell "RESTART in the console does not load a changed module"
    }
}

waits_for_restart() { [ "$1" != klipper ] || not_restarted=1; }

# The units of one kind, each of which belongs to another printer. What nobody
# knows of is taken to be printing.
restart_kind() {
    local unit units state
    units=$(services_of "$1")
    [ -n "$units" ] || tell "No $1 service found. Restart it yourself"
    for unit in $units; do
        state=$(state_of "$1" "$unit")
        # With no Klipper running nobody prints, but one whose unit has a name of
        # its own
        [ -n "$klippers" ] || [ "$state" = busy ] || state=idle
        if ! systemctl is-active --quiet "$unit"; then
            tell "$unit not restarted: it does not run"
        elif [ "$state" = busy ]; then
            waits_for_restart "$1"
            tell "$unit not restarted: a print is running. When it has ended:" \
                "sudo systemctl restart $unit"
        elif [ "$state" = unknown ]; then
            waits_for_restart "$1"
            tell "$unit not restarted: no Moonraker tells whether a print is" \
                "running. When it is not: sudo systemctl restart $unit"
        elif change as_root systemctl restart "$unit"; then
            report "Restarting $unit"
        else
            waits_for_restart "$1"
            problem "$RESTART" "$unit was not restarted; run: sudo systemctl" \
                "restart $unit"
        fi
    done
}

# Only somebody at a terminal can be asked for a password
# shellcheck disable=SC2329 # called by change
as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif [ -t 0 ]; then
        sudo "$@"
    else
        sudo -n "$@"
    fi
}
