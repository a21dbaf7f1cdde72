#!/usr/bin/env bash
#
# Links the modules of this checkout into Klipper or Kalico and has Moonraker
# keep the checkout up to date. --uninstall takes both back.
#
# Everything is looked at first; where something is in the way, nothing has
# been changed. There are no questions, and printer.cfg is never touched.

set -Eeuo pipefail
# Bytes, not characters: a file keeps what is not ours as it was
export LC_ALL=C
unset CDPATH GIT_DIR GIT_WORK_TREE GIT_INDEX_FILE

readonly SHIPPED="z_calibration auto_z_offset"
readonly SECTION="z_calibration" # of [update_manager ...], for all modules
readonly BRANCH="main"
readonly MARK="Added by install.sh of z_calibration"
readonly NO_END=" (the line before had no end)"
readonly NEW_FILE=" (the file is new)"

readonly UNEXPECTED=1 USAGE=2 ENVIRONMENT=3 CONFLICT=4 NOT_WRITABLE=5 RESTART=6

readonly PRINT_STATUS="/printer/objects/query?print_stats&idle_timeout"
# For machines with neither curl nor wget
readonly PYTHON_GET='
import sys, urllib.error, urllib.request as r
opener = r.build_opener(r.ProxyHandler({}))
try:
    answer = opener.open(sys.argv[1], timeout=3)
except urllib.error.HTTPError as error:
    answer = error
print(answer.read().decode())'

# Options
klipper=""
given_confs="" # lists have one entry in a line, as paths may contain spaces
services=""
modules=$SHIPPED
channel=""
kalico_override=""
use_moonraker=1
use_restart=1
dry_run=""
allow_root=""
force=""
uninstall=""

# What was found
here=""        # this checkout
folder=""      # klippy/extras, or klippy/plugins on Kalico
terminal=""    # set if somebody can be asked for a password
git_of_klipper="none"
git_prefix=""  # of Klipper in its repository
confs=""       # the moonraker.conf files to change
every_conf=""  # and all others, as their printers may be printing
origin=""
unregistrable="" # why Moonraker cannot update this checkout
first_problem=0

# What was done
links_changed=""
confs_changed=""
scratch=""

# Talking

say() { printf '%s\n' "$*"; }

note() { say "Note: $*"; }

complain() { printf 'Error: %s\n' "$*" >&2; }

fail() {
    local code=$1
    shift
    complain "$*"
    exit "$code"
}

# A reason not to begin; all of them are shown before the end.
problem() {
    local code=$1
    shift
    complain "$*"
    [ "$first_problem" -ne 0 ] || first_problem=$code
}

# report ACTION DETAIL: one line for what is done now
report() {
    local word="OK"
    [ -z "$dry_run" ] || word="DRY RUN"
    say "$1... [$word${2:+, $2}]"
}

change() { [ -n "$dry_run" ] || "$@"; }

usage() {
    cat <<END
usage: ./install.sh [options]

Links the modules into Klipper or Kalico and has Moonraker update them.

  -k, --klipper DIR          Klipper or Kalico (~/klipper, then ~/kalico)
  -m, --moonraker-conf FILE  a moonraker.conf, may be repeated (all that are
                             found)
  -s, --service NAME         a Klipper service to restart, may be repeated
                             (every klipper and klipper-NAME)
  -n N                       the services klipper-1 to klipper-N
      --modules "A B"        which modules ($SHIPPED)
      --channel NAME         dev, beta or stable: which releases Moonraker
                             installs (dev: every change)
      --kalico-override      link although Kalico ships a module of that name
      --no-moonraker         leave moonraker.conf alone
      --no-restart           restart no service
      --dry-run              show what would be done, change nothing
      --allow-root           for machines on which all runs as root
  -f, --force                replace an updater section of another checkout
  -u, --uninstall            take links and updater section back
  -h, --help                 this text

Exit codes: 0 done or nothing to do, 1 unexpected, 2 usage, 3 environment,
4 something is in the way, 5 not writable, 6 installed but not restarted.
END
}

# Options

needs_value() {
    [ $# -ge 2 ] && [ -n "$2" ] || fail "$USAGE" "$1 needs a value; see --help"
}

parse() {
    while [ $# -gt 0 ]; do
        case $1 in
            --*=*)
                local word=$1
                shift
                set -- "${word%%=*}" "${word#*=}" "$@"
                continue
                ;;
            -k | --klipper) needs_value "$@" && klipper=$2 && shift ;;
            -m | --moonraker-conf)
                needs_value "$@"
                given_confs+="$2"$'\n'
                shift
                ;;
            -s | --service)
                needs_value "$@"
                services+="${2%.service}"$'\n'
                shift
                ;;
            -n) needs_value "$@" && number_services "$2" && shift ;;
            --modules) needs_value "$@" && choose_modules "$2" && shift ;;
            --channel) needs_value "$@" && choose_channel "$2" && shift ;;
            --kalico-override) kalico_override=1 ;;
            --no-moonraker) use_moonraker="" ;;
            --no-restart) use_restart="" ;;
            --dry-run) dry_run=1 ;;
            --allow-root) allow_root=1 ;;
            -f | --force) force=1 ;;
            -u | --uninstall) uninstall=1 ;;
            -h | --help) usage && exit 0 ;;
            *) fail "$USAGE" "unknown option $1; see --help" ;;
        esac
        shift
    done
}

number_services() {
    local i
    case $1 in
        *[!0-9]* | 0*) fail "$USAGE" "-n: $1 is not a number above 0" ;;
        ???*) fail "$USAGE" "-n: $1 is more than anybody has" ;;
    esac
    for ((i = 1; i <= $1; i++)); do
        services+="klipper-$i"$'\n'
    done
}

choose_modules() {
    local name
    modules=""
    while IFS= read -r name; do
        [ -n "$name" ] || continue
        case " $SHIPPED " in
            *" $name "*) modules+="${modules:+ }$name" ;;
            *) fail "$USAGE" "no module $name; there are: $SHIPPED" ;;
        esac
    done <<<"$(tr -s '[:space:],' '\n' <<<"$1")"
    [ -n "$modules" ] || fail "$USAGE" "--modules: which? There are: $SHIPPED"
}

choose_channel() {
    case $1 in
        dev | beta | stable) channel=$1 ;;
        *) fail "$USAGE" "--channel: $1 is not dev, beta or stable" ;;
    esac
}

# Where things are

locate_self() {
    local script=${BASH_SOURCE[0]:-} name
    [ -n "$script" ] && [ -f "$script" ] ||
        fail "$ENVIRONMENT" "run the script from a clone: git clone, then" \
            "./install.sh in it"
    script=$(readlink -f -- "$script")
    here=$(cd -P -- "$(dirname -- "$script")" && pwd -P)
    for name in $SHIPPED; do
        [ -f "$here/$name.py" ] ||
            fail "$ENVIRONMENT" "$name.py is not beside $script; run the" \
                "script from a complete clone"
    done
}

refuse_root() {
    [ "$(id -u)" -ne 0 ] || [ -n "$allow_root" ] ||
        fail "$ENVIRONMENT" "do not run as root or with sudo; run it as the" \
            "user that Klipper runs as. Where that is root, add --allow-root"
}

require_home() {
    [ -n "${HOME:-}" ] && [ -d "$HOME" ] ||
        fail "$ENVIRONMENT" "HOME is not set to a directory; set it to that" \
            "of the user that Klipper runs as"
}

locate_klipper() {
    local found
    if [ -n "$klipper" ]; then
        [ -d "$klipper/klippy/extras" ] ||
            fail "$ENVIRONMENT" "no klippy/extras in $klipper; give the" \
                "directory of Klipper with -k"
    else
        for found in "$HOME/klipper" "$HOME/kalico"; do
            if [ -z "$klipper" ] && [ -d "$found/klippy/extras" ]; then
                klipper=$found
            fi
        done
    fi
    if [ -z "$klipper" ]; then
        [ -n "$uninstall" ] || fail "$ENVIRONMENT" "no Klipper in ~/klipper" \
            "or ~/kalico; give its path with -k"
        note "no Klipper in ~/klipper or ~/kalico; give its path with -k"
        return 0
    fi
    klipper=$(cd -P -- "$klipper" && pwd -P)
    folder="klippy/extras"
    [ ! -d "$klipper/klippy/plugins" ] || folder="klippy/plugins"
    look_at_git
}

# Whether git tells us what belongs to Klipper itself: none, ok or refuses
look_at_git() {
    if git -C "$klipper" ls-files -- klippy/extras >/dev/null \
        2>"$scratch/git"; then
        git_of_klipper="ok"
        git_prefix=$(git -C "$klipper" rev-parse --show-prefix)
    elif [ -e "$klipper/.git" ]; then
        git_of_klipper="refuses"
    fi
}

locate_confs() {
    local file
    while IFS= read -r file; do
        [ -z "$file" ] || [ -f "$file" ] ||
            fail "$ENVIRONMENT" "there is no $file; give a moonraker.conf" \
                "with -m"
        case $file in
            /* | "") add_conf "$file" ;;
            *) add_conf "$PWD/$file" ;;
        esac
    done <<<"$given_confs"
    confs=$every_conf
    for file in "$HOME"/*_data/config/moonraker.conf \
        "$HOME"/klipper_config/moonraker.conf \
        "$HOME"/klipper_config/*/moonraker.conf; do
        add_conf "$file"
    done
    [ -n "$given_confs" ] || confs=$every_conf
    [ -n "$use_moonraker" ] || confs=""
}

add_conf() {
    local known
    [ -f "$1" ] || return 0
    while IFS= read -r known; do
        [ -z "$known" ] || [ ! "$known" -ef "$1" ] || return 0
    done <<<"$every_conf"
    every_conf+="$1"$'\n'
}

# The directories with the configurations of the printers
config_folders() {
    local file
    while IFS= read -r file; do
        [ -z "$file" ] || dirname -- "$file"
    done <<<"$every_conf"
    for file in "$HOME"/*_data/config "$HOME"/klipper_config; do
        [ ! -d "$file" ] || printf '%s\n' "$file"
    done
}

# grep_configs FOLDER PATTERN: the *.cfg below it that match, but for what
# SAVE_CONFIG keeps as printer-20261121_174500.cfg
grep_configs() {
    local day='[0-9][0-9][0-9][0-9][0-9][0-9][0-9][0-9]'
    find -L "$1" -maxdepth 5 -name '*.cfg' -type f \
        ! -name "*-${day}_[0-9][0-9][0-9][0-9][0-9][0-9].cfg" \
        -exec grep -liE -e "$2" {} + 2>/dev/null || true
}

# Modules

is_tracked() {
    [ "$git_of_klipper" = ok ] &&
        git -C "$klipper" ls-files --error-unmatch -- "$1" >/dev/null 2>&1
}

# is_ours FILE: a link into this checkout, also one to a file that is gone
is_ours() {
    [ -L "$1" ] || return 1
    local target
    target=$(readlink -- "$1")
    case $target in
        "$here"/*) return 0 ;;
        *) [ "$1" -ef "$here/$(basename -- "$1")" ] ;;
    esac
}

# What is where a link of a module is to be, in one word
occupant() {
    local path="$folder/$1.py"
    local file="$klipper/$path"
    if is_tracked "$path" || is_tracked "$folder/$1/__init__.py"; then
        echo tracked
    elif [ -L "$file" ]; then
        if [ "$file" -ef "$here/$1.py" ]; then echo ours; else echo link; fi
    elif [ -d "$file" ] || [ -d "$klipper/$folder/$1" ]; then
        echo directory
    elif [ ! -e "$file" ]; then
        echo nothing
    elif [ "$git_of_klipper" = refuses ]; then
        echo unclear
    elif cmp -s -- "$file" "$here/$1.py"; then
        echo equal
    else
        echo other
    fi
}

check_module() {
    local file="$folder/$1.py" state
    state=$(occupant "$1")
    case $state in
        tracked)
            problem "$CONFLICT" "$file is part of this Klipper; replacing it" \
                "would block Klipper updates. Leave it out with --modules"
            [ ! -L "$klipper/$file" ] ||
                complain "It was replaced by a link. To restore it:" \
                    "git -C '$klipper' checkout -- '$file'"
            ;;
        directory)
            problem "$CONFLICT" "$klipper/$folder has a directory $1 or" \
                "$1.py; move it away first"
            ;;
        unclear)
            problem "$CONFLICT" "$file may be part of this Klipper, and git" \
                "does not tell: $(head -n 1 "$scratch/git")"
            ;;
    esac
    [ "$folder" = "klippy/extras" ] || check_kalico "$1"
}

# Kalico does not start with two modules of one name, unless it is told to.
check_kalico() {
    local extra="klippy/extras/$1" folders dir missing="" allowed=""
    if is_ours "$klipper/$extra.py" && ! is_tracked "$extra.py"; then
        return 0 # is taken away
    fi
    [ -e "$klipper/$extra.py" ] || [ -d "$klipper/$extra" ] ||
        is_tracked "$extra.py" || return 0
    [ ! -L "$klipper/$extra.py" ] || ! is_tracked "$extra.py" ||
        note "$extra.py of Kalico was replaced by a link, which blocks its" \
            "updates. To restore it: git -C '$klipper' checkout -- '$extra.py'"
    [ -z "$kalico_override" ] || return 0
    folders=$(config_folders | sort -u)
    while IFS= read -r dir; do
        if [ -z "$dir" ]; then
            continue
        elif allows_override "$dir"; then
            allowed=1
        elif [ -f "$dir/printer.cfg" ]; then
            missing+="$dir/printer.cfg"$'\n'
        fi
    done <<<"$folders"
    if [ -z "$allowed" ]; then
        problem "$CONFLICT" "Kalico ships its own $1. Add to printer.cfg" \
            "first, or Kalico will not start:"
        printf '\n[danger_options]\nallow_plugin_override: True\n\n' >&2
        complain "Then run this again. Other modules go without it, see" \
            "--modules; --kalico-override links in any case."
    elif [ -n "$missing" ]; then
        note "a printer with this Kalico does not start unless" \
            "allow_plugin_override is in its configuration, too:" \
            "${missing%$'\n'}"
    fi
}

allows_override() {
    local pattern='^allow_plugin_override[[:space:]]*[:=][[:space:]]*'
    pattern+='(true|yes|on|1)[[:space:]]*([#;].*)?$'
    [ -n "$(grep_configs "$1" "$pattern")" ]
}

link_module() {
    local file="$klipper/$folder/$1.py" action="Linking $1.py into $folder"
    local state kept detail=""
    state=$(occupant "$1")
    leave_extras "$1"
    case $state in
        ours)
            say "$action... [OK, already linked]"
            return 0
            ;;
        nothing) ;;
        link) detail="pointed to $(readlink -- "$file") before" ;;
        equal) detail="replaced an equal copy" ;;
        other)
            kept=$(free_name "$file.bak-$(date +%Y%m%d%H%M%S)")
            detail="old copy kept as $(basename -- "$kept")"
            change mv -- "$file" "$kept"
            ;;
    esac
    change ln -sfn -- "$here/$1.py" "$file"
    report "$action" "$detail"
    links_changed=1
}

# Of an installation before Klipper became Kalico
leave_extras() {
    local path="klippy/extras/$1.py"
    [ "$folder" != "klippy/extras" ] && is_ours "$klipper/$path" &&
        ! is_tracked "$path" || return 0
    change rm -- "$klipper/$path"
    report "Removing the old link $path"
    links_changed=1
}

unlink_module() {
    local dir file action state="not there"
    for dir in klippy/extras klippy/plugins; do
        file="$klipper/$dir/$1.py"
        action="Removing $1.py from $dir"
        if is_ours "$file"; then
            change rm -- "$file"
            report "$action"
            ! is_tracked "$dir/$1.py" ||
                note "$dir/$1.py is part of this Klipper. To restore it:" \
                    "git -C '$klipper' checkout -- '$dir/$1.py'"
            links_changed=1
            state=""
        elif [ -L "$file" ]; then
            say "$action... [SKIPPED, points to $(readlink -- "$file")]"
            state=""
        elif [ -e "$file" ] && [ "$dir" = "$folder" ]; then
            say "$action... [SKIPPED, not a link]"
            state=""
        fi
    done
    [ -z "$state" ] || say "Removing $1.py from $folder... [SKIPPED, $state]"
}

free_name() {
    local name=$1 count=1
    while [ -e "$name" ]; do
        name="$1-$count"
        count=$((count + 1))
    done
    printf '%s\n' "$name"
}

# Git's list of files that are not Klipper's

exclude_file() {
    local file
    file=$(git -C "$klipper" rev-parse --git-path info/exclude)
    case $file in
        /*) printf '%s\n' "$file" ;;
        *) printf '%s\n' "$klipper/$file" ;;
    esac
}

exclude_links() {
    local name path file
    if [ "$git_of_klipper" = refuses ]; then
        note "git does not tell about $klipper ($(head -n 1 "$scratch/git"));" \
            "the links were not added to its exclude file"
    fi
    [ "$git_of_klipper" = ok ] || return 0
    file=$(exclude_file)
    for name in $modules; do
        path="$folder/$name.py"
        if git -C "$klipper" check-ignore -q -- "$path" 2>/dev/null; then
            continue
        fi
        if [ -n "$dry_run" ] || exclude "/$git_prefix$path" "$file"; then
            report "Excluding $path from git status"
        else
            note "could not write to $file; git and Moonraker will list" \
                "$path as a new file, which is harmless"
        fi
    done
}

exclude() {
    local state=""
    mkdir -p -- "$(dirname -- "$2")" || return 1
    if [ ! -e "$2" ]; then
        state=$NEW_FILE
    elif ! ends_with_newline "$2"; then
        state=$NO_END
    fi
    {
        [ "$state" != "$NO_END" ] || echo
        printf '# %s%s\n%s\n' "$MARK" "$state" "$1"
    } 2>/dev/null >>"$2"
}

# Takes each of our marks away with the line after it, if that is one of ours
include_links() {
    local file names
    [ "$git_of_klipper" = ok ] || return 0
    file=$(exclude_file)
    [ -f "$file" ] && grep -qF -e "# $MARK" -- "$file" || return 0
    if ! can_write_over "$file"; then
        note "could not write to $file; the lines for the links stay there," \
            "which is harmless"
        return 0
    fi
    names=${modules// /|}
    awk -v mark="# $MARK" -v no_end="$NO_END" -v new_file="$NEW_FILE" \
        -v ours="^/(.*/)?klippy/(extras|plugins)/($names)[.]py\$" \
        -v open="$(is_open "$file")" '
        { line[NR] = $0 }
        END {
            for (i = 1; i <= NR; i++) {
                if (index(line[i], mark) == 1 && line[i + 1] ~ ours) {
                    if (index(line[i], no_end)) end = count
                    if (index(line[i], new_file)) new = 1
                    i++
                } else {
                    kept[++count] = line[i]
                }
            }
            if (!count && new) exit 9
            for (i = 1; i <= count; i++)
                printf "%s%s", kept[i],
                    ((i < count || !(open || end == count)) ? "\n" : "")
        }' "$file" >"$scratch/exclude" || {
        [ $? -eq 9 ] || return 1
        change rm -- "$file"
        report "Removing $file" "it was made for the links"
        return 0
    }
    cmp -s -- "$scratch/exclude" "$file" && return 0
    change write_over "$scratch/exclude" "$file"
    report "Removing the links from $file"
}

ends_with_newline() { [ -z "$(tail -c 1 -- "$1")" ]; }

is_open() { ends_with_newline "$1" || echo 1; }

# Its old text has to fit beside it, too
can_write_over() { [ -w "$1" ] && [ -w "$(dirname -- "$1")" ]; }

# write_over NEW FILE: in place, as a link stays a link then, and owner and
# mode stay. Until all is written the old text is kept beside it.
write_over() {
    local kept
    kept=$(free_name "$2.bak-$(date +%Y%m%d%H%M%S)")
    cp -p -- "$2" "$kept" ||
        fail "$UNEXPECTED" "could not keep a copy of $2, so it was left alone"
    if ! cat -- "$1" >"$2" || ! cmp -s -- "$1" "$2"; then
        fail "$UNEXPECTED" "could not write all of $2; its old text is in $kept"
    fi
    rm -- "$kept"
}

# Moonraker

# Whether and how Moonraker could update this checkout
look_at_checkout() {
    case $here in
        *[[:space:]]*)
            unregistrable="the path $here contains a space; Moonraker cannot"
            unregistrable+=" update such a checkout"
            return 0
            ;;
    esac
    if [ ! -e "$here/.git" ]; then
        unregistrable="$here is not a git clone"
    elif ! origin=$(git -C "$here" remote get-url origin 2>"$scratch/remote")
    then
        unregistrable="git does not tell where $here is from:"
        unregistrable+=" $(head -n 1 "$scratch/remote")"
    elif ! git -C "$here" symbolic-ref -q HEAD >/dev/null; then
        note "$here is on no branch, and Moonraker will not update it. To" \
            "change that: git -C '$here' checkout $BRANCH"
    fi
}

tilde_path() {
    local home
    home=$(cd -P -- "$HOME" && pwd -P)
    case $1 in
        "$home"/*) printf '%s/%s\n' '~' "${1#"$home"/}" ;;
        *) printf '%s\n' "$1" ;;
    esac
}

updater_text() {
    printf '[update_manager %s]\n' "$SECTION"
    printf 'type: git_repo\n'
    printf 'path: %s\n' "$(tilde_path "$here")"
    printf 'origin: %s\n' "$origin"
    printf 'primary_branch: %s\n' "$BRANCH"
    printf 'managed_services: klipper\n'
    [ -z "$channel" ] || printf 'channel: %s\n' "$channel"
}

# For grep and for every awk: some take a backslash in a string away
header_pattern() {
    printf '^[[]update_manager +(client +)?%s[]]' "$SECTION"
}

# A configuration and the files it includes
with_includes() {
    local conf=$1 depth=${2:-0} patterns pattern folder file
    printf '%s\n' "$conf"
    [ "$depth" -lt 8 ] || return 0
    patterns=$(sed -nE 's/^\[include +([^]]+)\].*/\1/p' "$conf")
    while IFS= read -r pattern; do
        case $pattern in
            "") continue ;;
            /*) folder="" ;;
            *) folder="$(dirname -- "$conf")/" ;;
        esac
        # Spaces belong to the path, the rest is for the shell to expand
        local IFS=
        # shellcheck disable=SC2086
        for file in "$folder"$pattern; do
            [ ! -f "$file" ] || with_includes "$file" $((depth + 1))
        done
    done <<<"$patterns"
}

# The file, of a configuration and what it includes, that has our section
section_file() {
    local files file
    files=$(with_includes "$1")
    while IFS= read -r file; do
        if grep -qE -e "$(header_pattern)" -- "$file"; then
            printf '%s\n' "$file"
            return 0
        fi
    done <<<"$files"
}

# section_value FILE KEY: what the last line of the section says
section_value() {
    awk -v header="$(header_pattern)" -v key="$2" '
        { sub(/\r$/, "") }
        /^\[/ { inside = $0 ~ header }
        inside && $0 ~ "^" key "[ \t]*[:=]" {
            sub(/^[^:=]*[:=][ \t]*/, "")
            sub(/([ \t]+[#;].*)?[ \t]*$/, "")
            value = $0
        }
        END { print value }' "$1"
}

updates_this() {
    local path
    path=$(section_value "$1" path)
    case $path in
        \~/*) path="$HOME/${path#??}" ;;
    esac
    [ "${path%/}" = "$here" ] || [ "$path" -ef "$here" ]
}

# Whether the section says what we would write
is_current() {
    updates_this "$1" || return 1
    [ "$(bare_origin "$(section_value "$1" origin)")" = \
        "$(bare_origin "$origin")" ] || return 1
    [ "$(section_value "$1" primary_branch)" = "$BRANCH" ] || return 1
    [ -z "$channel" ] || [ "$(section_value "$1" channel)" = "$channel" ]
}

bare_origin() {
    local bare
    bare=$(printf '%s' "$1" | tr '[:upper:]' '[:lower:]')
    printf '%s\n' "${bare%.git}"
}

check_conf() {
    local files file
    files=$(with_includes "$1" 2>/dev/null) || true
    while IFS= read -r file; do
        if [ ! -r "$file" ]; then
            problem "$NOT_WRITABLE" "cannot read $file"
            return 0
        fi
    done <<<"$files"
    file=$(section_file "$1")
    if [ -n "$file" ]; then
        if [ -n "$uninstall" ]; then
            updates_this "$file" || return 0
        else
            [ -n "$force" ] && ! is_current "$file" || return 0
        fi
    else
        file=$1
        [ -z "$uninstall" ] || return 0
    fi
    can_write_over "$file" ||
        problem "$NOT_WRITABLE" "cannot write to $file, or not beside it"
}

register() {
    local conf=$1 file kept action
    file=$(section_file "$conf")
    action="Adding [update_manager $SECTION] to $conf"
    if [ -z "$file" ]; then
        change append_updater "$conf"
        report "$action"
        [ -z "$dry_run" ] || updater_text
    elif is_current "$file"; then
        say "$action... [SKIPPED, already there]"
        return 0
    elif [ -z "$force" ]; then
        say "$action... [SKIPPED]"
        describe_difference "$file"
        return 0
    else
        kept=$(free_name "$file.bak-$(date +%Y%m%d%H%M%S)")
        change cp -p -- "$file" "$kept"
        change remove_updater "$file"
        change append_updater "$file"
        report "Replacing [update_manager $SECTION] in $file" \
            "old file kept as $(basename -- "$kept")"
        [ -z "$dry_run" ] || updater_text
    fi
    confs_changed=1
}

describe_difference() {
    if ! updates_this "$1"; then
        note "the section in $1 updates '$(section_value "$1" path)', not" \
            "this checkout; use --force to replace it"
    else
        note "the section in $1 has another origin, branch or channel; use" \
            "--force to replace it"
    fi
}

append_updater() {
    local state=""
    ends_with_newline "$1" || state=$NO_END
    {
        cat -- "$1"
        [ -z "$state" ] || echo
        [ ! -s "$1" ] || echo
        printf '# %s%s\n' "$MARK" "$state"
        updater_text
    } >"$scratch/updater"
    write_over "$scratch/updater" "$1"
}

# The section with our mark, and the empty line before it. What stands after
# its last option belongs to somebody else.
remove_updater() {
    awk -v header="$(header_pattern)" -v mark="# $MARK" -v no_end="$NO_END" \
        -v open="$(is_open "$1")" '
        function empty(text) { return text ~ /^[ \t\r]*$/ }
        { line[NR] = $0 }
        $0 ~ header && !first { first = NR }
        END {
            last = first
            for (i = first + 1; i <= NR && line[i] !~ /^\[/; i++)
                if (!empty(line[i]) && line[i] !~ /^[ \t]*[#;]/) last = i
            if (index(line[first - 1], mark) == 1) {
                first--
                cut = index(line[first], no_end) > 0
            }
            if (first > 1 && empty(line[first - 1])) first--
            if (last < NR) cut = open
            for (i = 1; i <= NR; i++) {
                if (i >= first && i <= last) continue
                if (count++) printf "\n"
                printf "%s", line[i]
            }
            if (count && !cut) printf "\n"
        }' "$1" >"$scratch/conf"
    write_over "$scratch/conf" "$1"
}

unregister() {
    local conf=$1 file action
    file=$(section_file "$conf")
    action="Removing [update_manager $SECTION] from ${file:-$conf}"
    if [ -z "$file" ]; then
        say "$action... [SKIPPED, not there]"
    elif ! updates_this "$file"; then
        say "$action... [SKIPPED, updates $(section_value "$file" path)]"
    else
        change remove_updater "$file"
        report "$action"
        confs_changed=1
    fi
}

set_up_updates() {
    local conf
    [ -n "$use_moonraker" ] || return 0
    if [ -z "$confs" ]; then
        [ -n "$uninstall" ] ||
            note "No moonraker.conf found: automatic updates not set up"
        return 0
    fi
    if [ -z "$uninstall" ] && [ -n "$unregistrable" ]; then
        note "automatic updates not set up: $unregistrable"
        return 0
    fi
    while IFS= read -r conf; do
        if [ -z "$conf" ]; then
            continue
        elif [ -n "$uninstall" ]; then
            unregister "$conf"
        else
            register "$conf"
        fi
    done <<<"$confs"
}

# Services

# is_service KIND NAME: klipper or klipper-NAME, but not its companions
is_service() {
    case $2 in
        "$1") return 0 ;;
        "$1"-mcu | "$1"-obico | "$1"-bambu | "$1"-companion | "$1"-hmi)
            return 1
            ;;
        "$1"-*[!0-9A-Za-z]* | "$1"-) return 1 ;;
        "$1"-*) return 0 ;;
    esac
    return 1
}

has_systemd() {
    local state
    command -v systemctl >/dev/null 2>&1 || return 1
    state=$(systemctl is-system-running 2>/dev/null) || true
    case $state in
        "" | offline | unknown) return 1 ;;
    esac
}

known_units() {
    systemctl list-unit-files --no-legend --no-pager --plain \
        "$1*.service" 2>/dev/null | awk '{ print $1 }' || true
}

is_active() { systemctl is-active --quiet "$1"; }

is_unit() { known_units "$1" | grep -qxF -e "$1.service"; }

# The services of a kind (klipper, moonraker), those asked for or all
services_of() {
    local unit wanted=${services%$'\n'}
    if [ -n "$wanted" ] && [ "$1" = klipper ]; then
        printf '%s\n' "$wanted"
    elif [ -n "$wanted" ]; then
        while IFS= read -r unit; do
            unit="$1${unit#klipper}"
            ! is_unit "$unit" || printf '%s\n' "$unit"
        done <<<"$wanted"
    else
        found_services "$1"
    fi
}

found_services() {
    local unit units
    units=$(known_units "$1")
    while IFS= read -r unit; do
        unit=${unit%.service}
        ! is_service "$1" "$unit" || printf '%s\n' "$unit"
    done <<<"$units"
}

check_services() {
    local unit
    [ -n "$services" ] && [ -n "$use_restart" ] && has_systemd || return 0
    while IFS= read -r unit; do
        is_unit "$unit" ||
            problem "$ENVIRONMENT" "there is no service $unit"
    done <<<"${services%$'\n'}"
}

# print_state UNITS: busy, idle or unknown, from what the Moonrakers say of
# the printers that these services of Klipper run
print_state() {
    local conf answer unit idle=0 running=0
    while IFS= read -r conf; do
        [ -n "$conf" ] || continue
        # Without a klippy, Moonraker knows no printer to ask
        answer=$(ask_moonraker "$conf" "/server/info")
        case $answer in
            *'"klippy_connected":false'*) ;;
            *) answer=$(ask_moonraker "$conf" "$PRINT_STATUS") ;;
        esac
        case $answer in
            *'"state":"printing"'* | *'"state":"Printing"'* | \
                *'"state":"paused"'*)
                echo busy
                return 0
                ;;
            *'"print_stats":'* | *'"klippy_connected":false'*)
                idle=$((idle + 1))
                ;;
        esac
    done <<<"$every_conf"
    while IFS= read -r unit; do
        [ -z "$unit" ] || ! is_active "$unit" || running=$((running + 1))
    done <<<"$1"
    if [ "$idle" -ge "$running" ]; then echo idle; else echo unknown; fi
}

# ask_moonraker CONF PATH: its answer without any white space
ask_moonraker() {
    local host port url
    host=$(server_value "$1" host)
    port=$(server_value "$1" port)
    case $host in
        "" | 0.0.0.0 | all | ::) host=127.0.0.1 ;;
    esac
    url="http://$host:${port:-7125}$2"
    get "$url" | tr -d '[:space:]'
}

get() {
    if command -v curl >/dev/null 2>&1; then
        curl -s -m 3 --noproxy '*' "$1" 2>/dev/null || true
    elif command -v wget >/dev/null 2>&1; then
        wget -q -T 3 -t 1 --no-proxy --content-on-error -O - "$1" \
            2>/dev/null || true
    elif command -v python3 >/dev/null 2>&1; then
        python3 -c "$PYTHON_GET" "$1" 2>/dev/null || true
    fi
}

# server_value CONF KEY: also from what it includes
server_value() {
    local files file
    files=$(with_includes "$1" 2>/dev/null) || true
    while IFS= read -r file; do
        [ ! -r "$file" ] || cat -- "$file"
        echo
    done <<<"$files" | awk -v key="$2" '
        { sub(/\r$/, "") }
        /^\[/ { inside = /^\[server\]/ }
        inside && $0 ~ "^" key "[ \t]*[:=]" {
            sub(/^[^:=]*[:=][ \t]*/, "")
            sub(/([ \t]+[#;].*)?[ \t]*$/, "")
            value = $0
        }
        END { print value }'
}

restart_services() {
    local wanted="" units="" what="" state
    if [ -z "$links_changed$confs_changed" ]; then
        say "Nothing changed; nothing to restart"
        return 0
    fi
    if [ -n "$links_changed" ] && ! is_startable; then
        links_changed=""
        [ -n "$confs_changed" ] || return 0
    fi
    [ -z "$links_changed" ] || what="Klipper"
    [ -z "$confs_changed" ] || what+="${what:+ and }Moonraker"
    if [ -z "$use_restart" ] || ! has_systemd; then
        say "Services not restarted. Restart $what yourself (the service; a" \
            "RESTART in the console does not load a changed module)"
        return 0
    fi
    hint_at_old_units
    [ -z "$links_changed" ] || wanted=$(services_of klipper)
    [ -z "$links_changed" ] || [ -n "$wanted" ] ||
        say "No klipper service found. Restart Klipper yourself"
    [ -z "$confs_changed" ] || units=$(services_of moonraker)
    [ -z "$confs_changed" ] || [ -n "$units" ] ||
        say "No moonraker service found. Restart Moonraker yourself"
    state=$(print_state "$({
        found_services klipper
        printf '%s' "$services"
    } | sort -u)")
    if [ "$state" = busy ]; then
        say "a print is running: nothing restarted. Afterwards:" \
            "sudo systemctl restart $(in_a_row "$wanted"$'\n'"$units")"
        return 0
    fi
    restart_units "$wanted" "$state"
    restart_units "$units" idle
    [ "$first_problem" -eq 0 ] || exit "$first_problem"
}

in_a_row() {
    # shellcheck disable=SC2086 # names of services, no spaces
    echo $1
}

restart_units() {
    local unit
    while IFS= read -r unit; do
        if [ -z "$unit" ]; then
            continue
        elif ! is_active "$unit" && [ -z "$services" ]; then
            say "$unit not restarted: it does not run"
        elif [ "$2" = unknown ] && is_active "$unit"; then
            say "$unit not restarted: no Moonraker tells whether a print is" \
                "running. When it is not: sudo systemctl restart $unit"
        elif [ -n "$dry_run" ]; then
            report "Restarting $unit"
        elif as_root systemctl restart "$unit" </dev/null; then
            report "Restarting $unit"
        else
            say "Restarting $unit... [FAILED]"
            problem "$RESTART" "$unit was not restarted; run: sudo systemctl" \
                "restart $unit"
        fi
    done <<<"$1"
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif [ -n "$terminal" ]; then
        sudo "$@"
    else
        sudo -n "$@"
    fi
}

# Units that made older releases of the plugin look like a service
hint_at_old_units() {
    local unit units
    units=$(known_units z_calibration && known_units klipper_z_calibration)
    while IFS= read -r unit; do
        case $unit in
            z_calibration.service | klipper_z_calibration.service)
                note "$unit is not needed any more. To remove it: sudo" \
                    "systemctl disable --now $unit; sudo rm" \
                    "/etc/systemd/system/$unit"
                ;;
        esac
    done <<<"$units"
}

# remains MODULE: one that is not ours
remains() {
    local file
    for file in "$klipper"/klippy/extras/"$1".py \
        "$klipper"/klippy/plugins/"$1".py; do
        [ ! -f "$file" ] || is_ours "$file" || return 0
    done
    return 1
}

# Whether Klipper would start without the modules that were removed
is_startable() {
    local name folders dir files file found=""
    [ -n "$uninstall" ] || return 0
    folders=$(config_folders | sort -u)
    for name in $modules; do
        ! remains "$name" || continue
        while IFS= read -r dir; do
            [ -n "$dir" ] || continue
            files=$(grep_configs "$dir" "^\\[$name( [^]]*)?\\]")
            while IFS= read -r file; do
                [ -z "$file" ] || found+="[$name] is still in $file"$'\n'
            done <<<"$files"
        done <<<"$folders"
    done
    [ -n "$found" ] || return 0
    printf '%s' "$found"
    say "Klipper will not start with it. Remove it, then restart Klipper"
    return 1
}

# Everything in order

check_links() {
    local name dir
    [ -n "$klipper" ] || return 0
    if [ -z "$uninstall" ]; then
        for name in $modules; do
            check_module "$name"
        done
        [ -w "$klipper/$folder" ] ||
            problem "$NOT_WRITABLE" "cannot write to $klipper/$folder"
        return 0
    fi
    for name in $modules; do
        for dir in klippy/extras klippy/plugins; do
            ! is_ours "$klipper/$dir/$name.py" || [ -w "$klipper/$dir" ] ||
                problem "$NOT_WRITABLE" "cannot write to $klipper/$dir"
        done
    done
}

check_confs() {
    local conf
    [ -n "$uninstall" ] || look_at_checkout
    [ -z "$unregistrable" ] || return 0
    while IFS= read -r conf; do
        [ -z "$conf" ] || check_conf "$conf"
    done <<<"$confs"
}

set_up_links() {
    local name
    [ -n "$klipper" ] || return 0
    for name in $modules; do
        if [ -n "$uninstall" ]; then
            unlink_module "$name"
        else
            link_module "$name"
        fi
    done
    if [ -n "$uninstall" ]; then include_links; else exclude_links; fi
}

say_what_next() {
    [ -n "$links_changed" ] && [ -z "$uninstall" ] || return 0
    say "Next: a section for the module in printer.cfg, see $here/README.md"
}

main() {
    # What fails in $( ) is told by who wanted its output
    trap '[ "$BASH_SUBSHELL" -gt 0 ] ||
        fail "$UNEXPECTED" "unexpected failure in line $LINENO"' ERR
    [ ! -t 0 ] || terminal=1
    parse "$@"
    require_home
    locate_self
    refuse_root
    scratch=$(mktemp -d)
    trap 'rm -rf -- "$scratch"' EXIT
    locate_klipper
    locate_confs
    check_links
    check_confs
    check_services
    if [ "$first_problem" -ne 0 ]; then
        complain "nothing was changed"
        exit "$first_problem"
    fi
    set_up_links
    set_up_updates
    say_what_next
    restart_services
}

# Sourced, the functions can be tried one by one.
if [ "${BASH_SOURCE[0]:-}" = "$0" ] || [ -z "${BASH_SOURCE[0]:-}" ]; then
    main "$@"
fi
