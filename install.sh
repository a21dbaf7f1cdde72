#!/usr/bin/env bash
#
# Links the modules of this checkout, and the folder that they share, into
# Klipper or Kalico and has Moonraker keep the checkout up to date.
# --uninstall takes both back.
#
# Everything is looked at first; where something is in the way, nothing has
# been changed. There are no questions, and printer.cfg is never touched.
# What it does with links, Moonraker and services is in installer/.

# For whoever types "sh install.sh": another shell knows too little
if [ -z "${BASH_VERSION:-}" ] || shopt -qo posix; then
    [ ! -f "$0" ] || exec bash "$0" "$@"
fi

set -Eeuo pipefail
# Whoever cuts off what is said, as with head, does not cut off what is done
trap '' PIPE
# Bytes, not characters: a file keeps what is not ours as it was
export LC_ALL=C
unset GIT_DIR GIT_WORK_TREE GIT_INDEX_FILE

# Those of them that are in the checkout
readonly MODULES="z_calibration auto_z_offset dockable_probe extra_probe"
# Always in klippy/extras, also where modules belong into klippy/plugins
readonly SHARED="klippy/extras/z_touch"
readonly SECTION="update_manager z_calibration" # one for all modules
readonly MARK="# Added by install.sh of z_calibration"

readonly UNEXPECTED=1 USAGE=2 ENVIRONMENT=3 CONFLICT=4 NOT_WRITABLE=5 RESTART=6

# Options
klipper="" given_confs=() given_modules="" use_moonraker=1 use_restart=1
dry_run="" allow_root="" force="" uninstall=""

# What was found
here="" origin=""   # this checkout, and where it is from
branch=""           # what it follows there
unregistrable=""    # why Moonraker cannot update it
modules=""          # those to link or unlink
folder=""           # where they belong: klippy/extras, or klippy/plugins
has_git=""          # whether Klipper is a clone
tracked=""          # files that are part of Klipper, each in a line
confs=()            # the moonraker.conf files to change
every_conf=()       # and all others, as their printers may be printing
scratch=""

# What was done
rehearsal="" first_problem=0 links_changed="" confs_changed="" unwritable=""
warnings=()         # shown at the end
not_restarted=""    # whether Klipper runs on without the new modules

# Talking

# say TEXT: as it is, also what another function reads
say() { printf '%s\n' "$*" 2>/dev/null || true; }

# tell TEXT: to a person, with ~ for the home directory, but not in quotes, where
# a shell takes it for a name
tell() {
    local text=" $*" long=" $HOME/" short=" ~/"
    text=${text//"$long"/"$short"}
    say "${text# }"
}

note() { tell "Note: $*"; }
warn() { warnings+=("$*"); }
complain() { tell "Error: $*" >&2; }
explain() { tell "  $*" >&2; }

# problem CODE TEXT: a reason not to begin; all are shown before the end
problem() {
    complain "${*:2}"
    [ "$first_problem" -ne 0 ] || first_problem=$1
}

fail() {
    problem "$@"
    exit "$1"
}

# report ACTION DETAIL: one line for what was done now
report() { tell "$1... [${dry_run:-OK}${2:+, $2}]"; }
change() { [ -n "$dry_run$rehearsal" ] || "$@"; }

# Each is told once
needs_writable() {
    [[ -w $1 || $unwritable = *":$1:"* ]] && return 0
    unwritable+=":$1:"
    problem "$NOT_WRITABLE" "cannot write to $1; give it to your user:" \
        "sudo chown $(id -un) $(printf %q "$1")"
}

# A file that is replaced, and its folder
needs_replaceable() {
    needs_writable "$1"
    needs_writable "$(dirname -- "$(readlink -f -- "$1")")"
}

# replace FILE: by what is in $scratch/new, at once: a full disk or a power cut
# leaves the old text. A link stays one; the mode stays, and the owner where the
# user may say so.
# shellcheck disable=SC2329 # called by change
replace() {
    local file new
    file=$(readlink -f -- "$1")
    new=$(mktemp -- "${file%/*}/.${file##*/}.XXXXXX") || return 1
    if cp -p -- "$file" "$new" && cat -- "$scratch/new" >"$new" &&
        mv -f -- "$new" "$file"; then
        return 0
    fi
    rm -f -- "$new"
    return 1
}

# The same; without it nothing goes on
# shellcheck disable=SC2329 # called by change
must_replace() {
    replace "$1" || fail "$UNEXPECTED" "could not write $1, which is as it" \
        "was; is the disk full?"
}

usage() {
    cat <<END
usage: ./install.sh [options]

Links the modules into Klipper or Kalico and has Moonraker update them.

  -k, --klipper DIR          Klipper or Kalico (~/klipper, then ~/kalico)
  -m, --moonraker-conf FILE  a moonraker.conf, may be repeated (all that are
                             found)
      --modules "A B"        which modules (all that are here)
      --no-moonraker         leave moonraker.conf alone
      --no-restart           restart no service
      --dry-run              show what would be done, change nothing
      --allow-root           for machines on which all runs as root
  -f, --force                replace what is in the way (links, files, an
                             updater section), and link beside Kalico's modules
  -u, --uninstall            take links and updater section back
  -h, --help                 this text

Exit codes: 0 done or nothing to do, 1 unexpected, 2 usage, 3 environment,
4 something is in the way, 5 not writable, 6 installed but not restarted.
END
}

# What is wanted, and where things are

needs_value() {
    [ $# -ge 2 ] && [ -n "$2" ] || fail "$USAGE" "$1 needs a value; see --help"
}

parse() {
    while [ $# -gt 0 ]; do
        case $1 in
            -k | --klipper) needs_value "$@" && klipper=$2 && shift ;;
            -m | --moonraker-conf)
                needs_value "$@" && given_confs+=("$2") && shift
                ;;
            --modules) needs_value "$@" && given_modules=$2 && shift ;;
            --no-moonraker) use_moonraker="" ;;
            --no-restart) use_restart="" ;;
            --dry-run) dry_run="DRY RUN" ;;
            --allow-root) allow_root=1 ;;
            -f | --force) force=1 ;;
            -u | --uninstall) uninstall=1 ;;
            -h | --help) usage && exit 0 ;;
            *) fail "$USAGE" "unknown option $1; see --help" ;;
        esac
        shift
    done
}

look_at_environment() {
    local script=${BASH_SOURCE[0]:-}
    [ -n "$script" ] && [ -f "$script" ] ||
        fail "$ENVIRONMENT" "the script is no file of a clone; git clone, then" \
            "run ./install.sh in it"
    here=$(dirname -- "$(readlink -f -- "$script")")
    [ -d "$here/installer" ] || fail "$ENVIRONMENT" "$here has no installer/;" \
        "run the script from a complete clone"
    # shellcheck source=installer/links.sh
    . "$here/installer/links.sh"
    # shellcheck source=installer/moonraker.sh
    . "$here/installer/moonraker.sh"
    # shellcheck source=installer/services.sh
    . "$here/installer/services.sh"
    [ "$(id -u)" -ne 0 ] || [ -n "$allow_root" ] ||
        fail "$ENVIRONMENT" "this runs as root or with sudo; run it as the" \
            "user that Klipper runs as, or, where that is root, with --allow-root"
}

choose_modules() {
    local name wanted known=$MODULES
    # A link of ours can be taken away even when its module is gone
    if [ -z "$uninstall" ]; then
        known=""
        for name in $MODULES; do
            [ ! -f "$here/$name.py" ] || known+="${known:+ }$name"
        done
        [ -n "$known" ] && [ -f "$here/${SHARED##*/}/__init__.py" ] ||
            fail "$ENVIRONMENT" "$here has no module or no ${SHARED##*/}; run" \
                "the script from a complete clone"
    fi
    read -ra wanted <<<"$given_modules"
    for name in "${wanted[@]}"; do
        case " $known " in
            *" $name "*) modules+="${modules:+ }$name" ;;
            *) fail "$USAGE" "no module $name; choose from: $known" ;;
        esac
    done
    modules=${modules:-$known}
}

locate_klipper() {
    local found first=""
    if [ -z "$klipper" ]; then
        for found in "$HOME/klipper" "$HOME/kalico"; do
            [ -d "$found/klippy/extras" ] || continue
            [ -z "$first" ] || note "using $first; for the other one:" \
                "-k '$found'"
            first=${first:-$found}
        done
        klipper=$first
    fi
    [ -n "$klipper" ] ||
        fail "$ENVIRONMENT" "no Klipper in ~/klipper or ~/kalico; give its" \
            "path with -k"
    [ -d "$klipper/klippy/extras" ] || fail "$ENVIRONMENT" "no klippy/extras" \
        "in $klipper; give the directory of Klipper with -k"
    klipper=$(readlink -f -- "$klipper")
    # Links of ours may keep that of Kalico when Klipper has come back
    folder="klippy/extras"
    [ ! -e "$klipper/klippy/plugins/__init__.py" ] || folder="klippy/plugins"
    if tracked=$(git -C "$klipper" ls-files -- klippy 2>"$scratch/git"); then
        tracked=$'\n'"$tracked"$'\n'
        [ ! -e "$klipper/.git" ] || has_git=1
    elif [ -e "$klipper/.git" ]; then
        problem "$ENVIRONMENT" "git does not tell what is part of $klipper:" \
            "$(cat -- "$scratch/git")"
    fi
    # Whoever has a section for Kalico's own goes on with that, unless it is ours
    if [ "$folder" = klippy/plugins ] && [ -z "$given_modules$uninstall" ] &&
        is_tracked klippy/extras/dockable_probe.py &&
        ! is_of_project klippy/plugins/dockable_probe.py; then
        modules=${modules/dockable_probe /}
        note "Kalico's own dockable_probe stays; --modules takes ours"
    fi
}

locate_confs() {
    local file found=("$HOME"/*_data/config/moonraker.conf
        "$HOME"/klipper_config/{,*/}moonraker.conf)
    for file in "${given_confs[@]}"; do
        [ -f "$file" ] || fail "$ENVIRONMENT" "there is no $file; give a" \
            "moonraker.conf with -m"
    done
    mapfile -t confs < <(each_once "${given_confs[@]}")
    mapfile -t every_conf < <(each_once "${confs[@]}" "${found[@]}")
    [ "${#confs[@]}" -gt 0 ] || confs=("${every_conf[@]}")
}

# Those that are there, each under its own name
each_once() {
    local file
    for file; do
        [ ! -f "$file" ] || readlink -f -- "$file"
    done | awk '!seen[$0]++'
}

# Everything in order

# The last lines: what did not go as wanted, and what to do next
finish() {
    local text
    for text in "${warnings[@]}"; do
        tell "Warning: $text"
    done
    if [ -n "$dry_run" ]; then
        tell "Dry run: nothing was changed"
    elif [ -n "$uninstall" ]; then
        tell "Uninstalled: ${modules// /, }"
    elif [ -n "$not_restarted" ]; then
        tell "Installed: ${modules// /, }. Next: restart Klipper as the lines" \
            "above say, then the quick start of your printer, see" \
            "$here/README.md"
    else
        tell "Installed: ${modules// /, }. Next: the quick start of your" \
            "printer, see $here/README.md"
    fi
}

main() {
    # What fails in $( ) is told by who wanted its output
    trap '[ "$BASH_SUBSHELL" -gt 0 ] ||
        fail "$UNEXPECTED" "unexpected failure in ${BASH_SOURCE[0]##*/}," \
            "line $LINENO"' ERR
    parse "$@"
    look_at_environment
    choose_modules
    scratch=$(mktemp -d)
    trap 'rm -rf -- "$scratch"' EXIT
    locate_klipper
    locate_confs
    # The same as below, but only complaints are heard
    rehearsal=1
    {
        set_up_links
        set_up_updates
    } >/dev/null
    rehearsal="" warnings=()
    if [ "$first_problem" -ne 0 ]; then
        complain "nothing was changed"
        exit "$first_problem"
    fi
    set_up_links
    set_up_updates
    restart_services
    finish
    exit "$first_problem"
}

main "$@"
