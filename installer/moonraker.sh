# shellcheck shell=bash
# Part of install.sh: the section for Moonraker's update manager.

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
    [ -z "$unregistrable" ] || return 0
    if [[ $origin =~ ^(https?://)[^/@]*@(.*)$ ]]; then
        origin="${BASH_REMATCH[1]}${BASH_REMATCH[2]}"
        note "the address that $here is from has a name or a password in it;" \
            "moonraker.conf gets it without: $origin"
    fi
    if ! branch=$(git -C "$here" symbolic-ref --short -q HEAD); then
        branch=main
        note "$here is at a commit of no branch; Moonraker is told branch main"
    elif [ "$branch" != main ]; then
        note "$here is on branch $branch, not main: updates are those of $branch"
    fi
}

updater_text() {
    cat <<END
$MARK
[$SECTION]
type: git_repo
path: ${here/#"$HOME"\//\~/}
origin: $origin
primary_branch: $branch
managed_services: klipper
END
}

# What begins a section of ours
readonly HEADER="^[[]update_manager[ \t]+(client[ \t]+)?${SECTION#* }[ \t]*[]]"

# Whether this script has written the section that is in a file
is_written_by_us() {
    awk -v header="$HEADER" -v mark="$MARK" '
        $0 ~ header && index(before, mark) == 1 { found = 1 }
        { before = $0 }
        END { exit !found }' "$1"
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
        # Not sed, which leaves the end of the last line as it is
    done < <(awk '/^\[include[ \t]+[^]]+\]/ {
        sub(/^\[include[ \t]+/, "")
        sub(/\].*/, "")
        print
    }' "$conf")
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
                gsub(/[ \t]+/, " ", section)
                sub(/ $/, "", section)
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
    local conf users=""
    [ -n "$use_moonraker" ] || return 0
    if [ -n "$uninstall" ]; then
        users=$(still_linked)
    else
        look_at_checkout
    fi
    if [ -n "$users" ] && [ "${#confs[@]}" -gt 0 ]; then
        note "moonraker.conf stays as it is, for updates of the links that are" \
            "still in ${users//$'\n'/ and }"
        return 0
    fi
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
    local file="" files path theirs followed ours=${origin%.git} is_path_ours=""
    local is_moved=""
    if [ ! -r "$1" ]; then
        problem "$NOT_WRITABLE" "cannot read $1"
        return 0
    fi
    mapfile -t files < <(settings "$1" | awk -F '\t' -v section="$SECTION" '
        $2 == section && $3 == "" { print $1 }')
    # Of several files the last one counts
    [ "${#files[@]}" -eq 0 ] || file=${files[-1]}
    path=$(setting "$1" "$SECTION" path)
    theirs=$(setting "$1" "$SECTION" origin)
    followed=$(setting "$1" "$SECTION" primary_branch)
    [ ! "${path/#\~/$HOME}" -ef "$here" ] || is_path_ours=1
    # Of a clone that was moved, or is gone
    [ -z "$file" ] || [ -e "${path/#\~/$HOME}" ] ||
        ! is_written_by_us "$file" || is_moved=1
    if [ -z "$file" ]; then
        [ -z "$uninstall" ] || return 0
        needs_replaceable "$1"
        change append "$(updater_text)" "$1" ||
            fail "$UNEXPECTED" "could not write $1, which is as it was; is the" \
                "disk full?"
        report "Adding [$SECTION] to $1"
    elif [ -n "$uninstall" ] && [ -n "$is_path_ours$is_moved" ]; then
        rewrite "$file"
        report "Removing [$SECTION] from $file"
    elif [ -n "$is_path_ours" ] && [ "${theirs%.git}" = "$ours" ] &&
        [ "${followed:-$branch}" = "$branch" ]; then
        tell "Adding [$SECTION] to $1... [SKIPPED, already there]"
        return 0
    elif [ -n "$force$is_moved" ] && [ -z "$uninstall" ]; then
        rewrite "$file" "$(updater_text)"
        report "Replacing [$SECTION] in $file"
    else
        if [ "${followed:-$branch}" != "$branch" ]; then
            theirs+=" (branch $followed)"
        fi
        if [ -n "$uninstall" ]; then
            tell "[$SECTION] in $file updates $path, not $here... [SKIPPED]"
        else
            tell "Adding [$SECTION] to $1... [SKIPPED, see below]"
            warn "you will not see our updates: [$SECTION] in $file updates" \
                "$path from $theirs, not $here from $origin; to replace that" \
                "section run this again with --force"
        fi
        return 0
    fi
    [ -z "$dry_run" ] || [ -n "$uninstall" ] || updater_text
    confs_changed=1
}

# rewrite FILE TEXT: without all sections that are ours, their mark and the empty
# line before, and with TEXT at its end. What stands after our last option
# belongs to somebody else.
rewrite() {
    local kept
    needs_replaceable "$1"
    awk -v header="$HEADER" -v mark="$MARK" '
        function empty(text) { return text ~ /^[ \t\r]*$/ }
        { line[NR] = $0 }
        /^\[/ {
            inside = $0 ~ header
            if (inside) first[++n] = NR
        }
        inside && !empty($0) && !/^[ \t]*[#;]/ { last[n] = NR }
        END {
            for (k = 1; k <= n; k++) {
                i = first[k]
                if (index(line[i - 1], mark) == 1) i--
                if (i > 1 && empty(line[i - 1])) i--
                for (; i <= last[k]; i++) gone[i] = 1
            }
            for (i = 1; i <= NR; i++) if (!(i in gone)) print line[i]
        }' "$1" >"$scratch/new"
    [ $# -eq 1 ] || printf '\n%s\n' "$2" >>"$scratch/new"
    [ -z "$dry_run$rehearsal" ] || return 0
    kept=$(backup_name "$1")
    cp -p -- "$1" "$kept" || fail "$UNEXPECTED" "could not keep the old text of" \
        "$1, which is as it was; is the disk full?"
    must_replace "$1"
    note "the old text of $1 is kept as ${kept##*/}"
}

# append TEXT FILE: after an empty line, or the end that the last one lacks
# shellcheck disable=SC2329 # called by change
append() {
    [ -e "$2" ] || : >"$2" || return 1
    { cat -- "$2" && printf '\n%s\n' "$1"; } >"$scratch/new" && replace "$2"
}

backup_name() { say "$1.bak-$(date +%Y%m%d%H%M%S)-$$"; }
