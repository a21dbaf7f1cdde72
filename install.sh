#!/usr/bin/env bash
#
# Links the modules of this checkout, and the folder that they share, into
# Klipper or Kalico and has Moonraker keep the checkout up to date.
# --uninstall takes both back.
#
# Everything is looked at first; where something is in the way, nothing has
# been changed. There are no questions, and printer.cfg is never touched.

set -Eeuo pipefail
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

# Where Moonraker is, there is a Python 3, but not always curl
readonly PRINT_STATE='
import json, sys, urllib.request as request

opener = request.build_opener(request.ProxyHandler({}))

def ask(path):
    with opener.open(sys.argv[1] + path, timeout=3) as answer:
        return json.load(answer)["result"]

state = "idle"  # a klippy that is not ready prints nothing
if ask("/server/info")["klippy_state"] == "ready":
    status = ask("/printer/objects/query?print_stats&idle_timeout")["status"]
    states = [status[name]["state"] for name in ("print_stats", "idle_timeout")]
    if {"printing", "paused", "Printing"}.intersection(states):
        state = "busy"
print(state)'

# Options
klipper="" given_confs=() given_modules="" use_moonraker=1 use_restart=1
dry_run="" allow_root="" force="" uninstall=""

# What was found
here="" origin=""   # this checkout, and where it is from
unregistrable=""    # why Moonraker cannot update it
modules=""          # those to link or unlink
folder=""           # where they belong: klippy/extras, or klippy/plugins
git_prefix="-"      # of Klipper in its repository, - if it is in none
confs=()            # the moonraker.conf files to change
every_conf=()       # and all others, as their printers may be printing
scratch=""

# What was done
rehearsal="" first_problem=0 links_changed="" confs_changed=""

# Talking

say() { printf '%s\n' "$*"; }
note() { say "Note: $*"; }
complain() { printf 'Error: %s\n' "$*" >&2; }
explain() { printf '  %s\n' "$*" >&2; }

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
report() { say "$1... [${dry_run:-OK}${2:+, $2}]"; }
change() { [ -n "$dry_run$rehearsal" ] || "$@"; }

needs_writable() {
    [ -w "$1" ] || problem "$NOT_WRITABLE" "cannot write to $1"
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
  -f, --force                replace what is somebody else's (links, files, an
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
            -n | -s)
                needs_value "$@" && shift
                note "-n and -s are ignored: every Klipper service is found"
                ;;
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
        fail "$ENVIRONMENT" "run the script from a clone: git clone, then" \
            "./install.sh in it"
    here=$(dirname -- "$(readlink -f -- "$script")")
    [ "$(id -u)" -ne 0 ] || [ -n "$allow_root" ] ||
        fail "$ENVIRONMENT" "do not run as root or with sudo; run it as the" \
            "user that Klipper runs as. Where that is root, add --allow-root"
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
            *) fail "$USAGE" "no module $name; there are: $known" ;;
        esac
    done
    modules=${modules:-$known}
}

locate_klipper() {
    local found
    for found in "$HOME/klipper" "$HOME/kalico"; do
        [ -n "$klipper" ] || [ ! -d "$found/klippy/extras" ] || klipper=$found
    done
    [ -n "$klipper" ] ||
        fail "$ENVIRONMENT" "no Klipper in ~/klipper or ~/kalico; give its" \
            "path with -k"
    [ -d "$klipper/klippy/extras" ] || fail "$ENVIRONMENT" "no klippy/extras" \
        "in $klipper; give the directory of Klipper with -k"
    klipper=$(readlink -f -- "$klipper")
    # Links of ours may keep that of Kalico when Klipper has come back
    folder="klippy/extras"
    [ ! -e "$klipper/klippy/plugins/__init__.py" ] || folder="klippy/plugins"
    # With the index, which tells what is part of Klipper
    if git -C "$klipper" ls-files -- klippy >/dev/null 2>"$scratch/git"; then
        git_prefix=$(git -C "$klipper" rev-parse --show-prefix)
    elif [ -e "$klipper/.git" ]; then
        problem "$ENVIRONMENT" "git does not tell what is part of $klipper:" \
            "$(cat -- "$scratch/git")"
    fi
    # Whoever has a section for Kalico's own goes on with that
    if [ "$folder" = klippy/plugins ] && [ -z "$given_modules$uninstall" ] &&
        is_tracked klippy/extras/dockable_probe.py; then
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

# Links. A place is where one may be, from the directory of Klipper on.

# Those of our modules, and the folder unless another module needs it
places() {
    local name dir is_needed=""
    for name in $MODULES; do
        for dir in klippy/extras klippy/plugins; do
            case " $modules " in
                *" $name "*) say "$dir/$name.py" ;;
                *) ! is_ours "$dir/$name.py" || is_needed=$uninstall ;;
            esac
        done
    done
    [ -n "$is_needed" ] || say "$SHARED"
}

# Where a link has to be; in the other one of Kalico's folders it must not
is_wanted() {
    [ -z "$uninstall" ] && [[ $1 = "$SHARED" || ${1%/*} = "$folder" ]]
}

# Whether it, or a package of that name, is part of Klipper
is_tracked() {
    [ "$git_prefix" != - ] &&
        [ -n "$(git -C "$klipper" ls-files -- "$1" "${1%.py}")" ]
}

# A link into this checkout, also one to a file that is gone
is_ours() {
    [ -L "$klipper/$1" ] && [[ $(readlink -f -- "$klipper/$1") = "$here"/* ]]
}

# A link to a file that is gone is of use to nobody
is_foreign() { [ -e "$klipper/$1" ] && ! is_ours "$1"; }

set_up_links() {
    local place emptied=""
    for place in $(places); do
        if is_wanted "$place"; then
            link "$place"
        elif is_ours "$place"; then
            needs_writable "$klipper/${place%/*}"
            ! is_tracked "$place" || note "$place is part of this Klipper. To" \
                "restore it: git -C '$klipper' checkout -- '$place'"
            change rm -- "$klipper/$place"
            report "Removing ${place##*/} from ${place%/*}"
            emptied+=" $place"
            links_changed=1
        fi
    done
    [ -n "$uninstall" ] || check_kalico
    [ "$git_prefix" = - ] || set_up_exclude "$emptied"
}

link() {
    local file="$klipper/$1" name=${1##*/} kept detail=""
    local action="Linking $name into ${1%/*}"
    if is_tracked "$1"; then
        problem "$CONFLICT" "$1 is part of this Klipper; replacing it would" \
            "block Klipper updates. Leave it out with --modules"
        return 0
    elif is_ours "$1" && [ "$file" -ef "$here/$name" ]; then
        say "$action... [OK, already linked]"
        return 0
    elif is_foreign "$1" && [ -z "$force" ]; then
        refuse_to_replace "$1"
        return 0
    fi
    needs_writable "${file%/*}"
    ! is_foreign "$1" || note "$(difference "$name")"
    if [ -L "$file" ]; then
        detail="pointed to $(readlink -- "$file") before"
    elif [ -e "$file" ]; then
        kept=$(backup_name "$file")
        detail="old one kept as ${kept##*/}"
        change mv -- "$file" "$kept"
    fi
    # Not into the directory that an old link points to
    change ln -sfn -- "$here/$name" "$file"
    report "$action" "$detail"
    links_changed=1
}

refuse_to_replace() {
    local file="$klipper/$1" name=${1##*/} target="" updater=""
    if [ -L "$file" ]; then
        target=$(readlink -f -- "$file")
        updater=$(updater_of "$target")
        problem "$CONFLICT" "$file belongs to somebody else: it is a link to" \
            "$target"
    else
        problem "$CONFLICT" "$file is no link, so this script has not made it"
    fi
    explain "$(difference "$name")"
    [ -z "$updater" ] || explain "Its updates come by $updater, and may put" \
        "it back: remove that section"
    explain "To change to ours: --force, which keeps a file or folder as" \
        "$name.bak- and the time; or rm -r '$file' and run this again"
    [ "$1" = "$SHARED" ] || explain "To leave it there: name the others with" \
        "--modules"
}

# What is new to users of another one of that name
difference() {
    case $1 in
        auto_z_offset.py)
            say "With ours, z_offset of [auto_z_offset] has the opposite sign" \
                "(-0.1 there is 0.1 here); calibrated_z_offset," \
                "activate_gcode, deactivate_gcode, x_offset and y_offset are" \
                "ignored. See $here/docs/auto_z_offset.md, How do I migrate"
            ;;
        *.py) say "What differs with ours is in $here/docs/migration.md" ;;
        *) say "Our modules need that of this checkout" ;;
    esac
}

# updater_of FILE: the section that updates it, and where that is
updater_of() {
    local conf file section option value
    for conf in "${every_conf[@]}"; do
        while IFS=$'\t' read -r file section option value; do
            [ "${section%% *}/$option" = update_manager/path ] || continue
            value=$(readlink -f -- "${value/#\~/$HOME}") || continue
            [[ $1 != "$value"/?* ]] || say "[$section] in $file"
        done < <(settings "$conf")
    done
}

# Kalico does not start with two modules of one name, unless it is told to.
check_kalico() {
    local name shipped="" others=""
    [ "$folder" = klippy/plugins ] && [ -z "$force" ] || return 0
    for name in $modules; do
        if is_tracked "klippy/extras/$name.py"; then
            shipped+="${shipped:+ and }$name"
        elif is_foreign "klippy/extras/$name.py"; then
            refuse_to_replace "klippy/extras/$name.py"
        else
            others+="${others:+ }$name"
        fi
    done
    [ -n "$shipped" ] && ! is_override_allowed || return 0
    problem "$CONFLICT" "Kalico ships its own $shipped. Add to printer.cfg" \
        "first, or Kalico will not start:"
    printf '\n[danger_options]\nallow_plugin_override: True\n\n' >&2
    explain "Then run this again; --force links in any case." \
        "${others:+Without it: --modules \"$others\"}"
}

# In any configuration but those that SAVE_CONFIG leaves behind, such as
# printer-20261121_174500.cfg
is_override_allowed() {
    local pattern='^allow_plugin_override[[:space:]]*[:=][[:space:]]*'
    pattern+='(true|yes|on|1)[[:space:]]*([#;].*)?$'
    [ -n "$(find -L "${every_conf[@]%/*}" "$HOME"/*_data/config \
        "$HOME"/klipper_config -maxdepth 5 -name '*.cfg' \
        ! -name 'printer-[0-9]*_[0-9]*.cfg' \
        -exec grep -liE -e "$pattern" {} + 2>/dev/null)" ]
}

# set_up_exclude REMOVED: git's list of files that are not Klipper's. If it
# cannot be written, git shows what is harmless.
set_up_exclude() {
    local file place new=""
    file=$(git -C "$klipper" rev-parse --git-path info/exclude)
    [[ $file = /* ]] || file="$klipper/$file"
    for place in $(places); do
        ! is_wanted "$place" ||
            git -C "$klipper" check-ignore -q -- "$place" ||
            new+=$'\n'"/$git_prefix$place"
    done
    if [ -n "$new" ]; then
        if change append "$MARK$new" "$file" 2>/dev/null; then
            report "Excluding the links from git status" "in $file"
        else
            note "cannot write to $file; git will list the links as new files"
        fi
    fi
    for place in $1; do
        change sed -i -e "/^$MARK/d" -e "\|^/$git_prefix$place\$|d" "$file" \
            2>/dev/null || true
    done
}

# Moonraker

# Whether and how Moonraker could update this checkout
look_at_checkout() {
    # Not where a repository around it is from
    if ! origin=$(GIT_CEILING_DIRECTORIES=${here%/*} \
        git -C "$here" remote get-url origin 2>"$scratch/git"); then
        unregistrable="git does not tell where $here is from:"
        unregistrable+=" $(cat -- "$scratch/git")"
    elif [[ $here = *[[:space:]]* ]]; then
        unregistrable="Moonraker updates no path with a space, such as $here"
    fi
}

updater_text() {
    cat <<END
$MARK
[$SECTION]
type: git_repo
path: ${here/#"$HOME"\//\~/}
origin: $origin
primary_branch: main
managed_services: klipper
END
}

# A configuration and the files it includes, as far as they can be read
with_includes() {
    local conf=$1 depth=${2:-0} pattern file
    [ -r "$conf" ] && [ "$depth" -lt 8 ] || return 0
    say "$conf"
    while IFS= read -r pattern; do
        [ "${pattern:0:1}" = / ] || pattern="$(dirname -- "$conf")/$pattern"
        # Spaces belong to the path, the rest is for the shell to expand
        local IFS=
        # shellcheck disable=SC2086
        for file in $pattern; do
            with_includes "$file" $((depth + 1))
        done
    done < <(sed -nE 's/^\[include +([^]]+)\].*/\1/p' "$conf")
}

# settings CONF: each option as file, section, option and value, with tabs
# between; for each section a line without option before
settings() {
    local file
    while IFS= read -r file; do
        awk -v OFS='\t' '
            { sub(/\r$/, "") }
            /^\[/ {
                section = substr($0, 2)
                sub(/\].*/, "", section)
                gsub(/ +/, " ", section)
                sub(/^update_manager client /, "update_manager ", section)
                print FILENAME, section, "", ""
            }
            section && /^[^#; \t[][^:=]*[:=]/ {
                option = value = $0
                sub(/[ \t]*[:=].*/, "", option)
                sub(/^[^:=]*[:=][ \t]*/, "", value)
                sub(/([ \t]+[#;].*)?[ \t]*$/, "", value)
                print FILENAME, section, option, value
            }' "$file"
    done < <(with_includes "$1")
}

# setting CONF SECTION OPTION: the last value; with no OPTION the file that has
# the section
setting() {
    settings "$1" | awk -F '\t' -v section="$2" -v option="${3:-}" '
        $2 == section && $3 == option { value = (option == "") ? $1 : $4 }
        END { print value }'
}

set_up_updates() {
    local conf
    [ -n "$use_moonraker" ] || return 0
    [ -n "$uninstall" ] || look_at_checkout
    if [ -n "$unregistrable" ]; then
        note "automatic updates not set up: $unregistrable"
        return 0
    fi
    [ "${#confs[@]}" -gt 0 ] || [ -n "$uninstall" ] ||
        note "No moonraker.conf found: automatic updates not set up"
    for conf in "${confs[@]}"; do
        set_up_conf "$conf"
    done
}

set_up_conf() {
    local file path theirs ours=${origin%.git} is_path_ours=""
    if [ ! -r "$1" ]; then
        problem "$NOT_WRITABLE" "cannot read $1"
        return 0
    fi
    file=$(setting "$1" "$SECTION")
    path=$(setting "$1" "$SECTION" path)
    theirs=$(setting "$1" "$SECTION" origin)
    [ ! "${path/#\~/$HOME}" -ef "$here" ] || is_path_ours=1
    if [ -z "$file" ]; then
        [ -z "$uninstall" ] || return 0
        needs_writable "$1"
        change append "$(updater_text)" "$1"
        report "Adding [$SECTION] to $1"
    elif [ -n "$uninstall" ] && [ -n "$is_path_ours" ]; then
        rewrite "$file"
        report "Removing [$SECTION] from $file"
    elif [ -n "$is_path_ours" ] && [ "${theirs%.git}" = "$ours" ]; then
        say "Adding [$SECTION] to $1... [SKIPPED, already there]"
        return 0
    elif [ -n "$force" ] && [ -z "$uninstall" ]; then
        rewrite "$file" "$(updater_text)"
        report "Replacing [$SECTION] in $file"
    else
        say "[$SECTION] in $file updates $path from $theirs, not" \
            "$here${origin:+ from $origin}... [SKIPPED]"
        [ -n "$uninstall" ] || note "--force replaces that section"
        return 0
    fi
    [ -z "$dry_run" ] || [ -n "$uninstall" ] || updater_text
    confs_changed=1
}

# rewrite FILE TEXT: in place, as a link stays a link then, and owner and mode
# stay: without our section and mark and the empty line before, and with TEXT
# at its end. What stands after our last option belongs to somebody else.
rewrite() {
    local kept
    needs_writable "$1"
    needs_writable "$(dirname -- "$1")"
    awk -v header="^[[]update_manager +(client +)?${SECTION#* }[]]" \
        -v mark="$MARK" '
        function empty(text) { return text ~ /^[ \t\r]*$/ }
        { line[NR] = $0 }
        /^\[/ { inside = $0 ~ header }
        inside && $0 ~ header { first = NR }
        inside && !empty($0) && !/^[ \t]*[#;]/ { last = NR }
        END {
            if (index(line[first - 1], mark) == 1) first--
            if (empty(line[first - 1])) first--
            for (i = 1; i <= NR; i++) if (i < first || i > last) print line[i]
        }' "$1" >"$scratch/new"
    [ $# -eq 1 ] || append "$2" "$scratch/new"
    [ -z "$dry_run$rehearsal" ] || return 0
    kept=$(backup_name "$1")
    cp -p -- "$1" "$kept"
    cat -- "$scratch/new" >"$1" || fail "$UNEXPECTED" "could not write all of" \
        "$1; its old text is in $kept"
    note "the old text of $1 is kept as ${kept##*/}"
}

# append TEXT FILE: after an empty line, or the end that the last one lacks
append() { printf '\n%s\n' "$1" >>"$2"; }
backup_name() { say "$1.bak-$(date +%Y%m%d%H%M%S)-$$"; }

# Services

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

# What the Moonrakers say of the printers that run: busy, unknown or nothing
print_state() {
    local conf url unit answers running=0
    answers=$(for conf in "${every_conf[@]}"; do
        url_of "$conf"
    done | sort -u | while IFS= read -r url; do
        python3 -c "$PRINT_STATE" "$url" 2>/dev/null || true
    done)
    for unit in $(services_of klipper); do
        ! systemctl is-active --quiet "$unit" || running=$((running + 1))
    done
    if [[ $answers = *busy* ]]; then
        say busy
    elif [ "$(grep -c idle <<<"$answers")" -lt "$running" ]; then
        say unknown
    fi
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
    local what kind state
    if [ -z "$links_changed$confs_changed" ]; then
        say "Nothing changed; nothing to restart"
        return 0
    fi
    if [ -n "$links_changed" ] && [ -n "$uninstall" ]; then
        say "Klipper is not restarted: it does not start while printer.cfg" \
            "has a section of a removed module. Remove that, then restart it"
        links_changed=""
    fi
    what="${links_changed:+Klipper}${confs_changed:+ Moonraker}"
    [ -n "$what" ] || return 0
    what=${what# }
    if [ -z "$use_restart" ] || ! has_systemd; then
        say "Services not restarted. Restart ${what/ / and } yourself (the" \
            "service; RESTART in the console does not load a changed module)"
        return 0
    fi
    state=$(print_state)
    if [ "$state" = busy ]; then
        say "A print is running: nothing restarted. When it has ended," \
            "restart ${what/ / and }"
        return 0
    fi
    for kind in $what; do
        restart "${kind,,}" "$state"
    done
}

restart() {
    local unit units
    units=$(services_of "$1")
    [ -n "$units" ] || say "No $1 service found. Restart it yourself"
    for unit in $units; do
        if ! systemctl is-active --quiet "$unit"; then
            say "$unit not restarted: it does not run"
        elif [ "$1/$2" = klipper/unknown ]; then
            say "$unit not restarted: no Moonraker tells whether a print is" \
                "running. When it is not: sudo systemctl restart $unit"
        elif change as_root systemctl restart "$unit"; then
            report "Restarting $unit"
        else
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

# Everything in order

main() {
    # What fails in $( ) is told by who wanted its output
    trap '[ "$BASH_SUBSHELL" -gt 0 ] ||
        fail "$UNEXPECTED" "unexpected failure in line $LINENO"' ERR
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
    rehearsal=""
    if [ "$first_problem" -ne 0 ]; then
        complain "nothing was changed"
        exit "$first_problem"
    fi
    set_up_links
    set_up_updates
    [ -z "$links_changed" ] || [ -n "$uninstall" ] ||
        say "Next: a section in printer.cfg for each module that you use, see" \
            "$here/README.md"
    restart_services
    exit "$first_problem"
}

main "$@"
