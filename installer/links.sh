# shellcheck shell=bash
# Part of install.sh: links into Klipper or Kalico.

# A place is where a link of this project may be, from the directory of Klipper on.

every_place() {
    local name
    for name in $MODULES; do
        printf '%s\n' "klippy/extras/$name.py" "klippy/plugins/$name.py"
    done
    say "$SHARED"
}

# Whether it is that of a module to link or unlink, or the folder
is_chosen() {
    local name=${1##*/}
    [[ $1 = "$SHARED" || " $modules " = *" ${name%.py} "* ]]
}

# Whether a link has to be there; in the other one of Kalico's folders it must not
is_wanted() {
    [ -z "$uninstall" ] && is_chosen "$1" &&
        [[ $1 = "$SHARED" || ${1%/*} = "$folder" ]]
}

# Whether a link that is there has to go: one of ours, one of the checkout that is
# changed to this one, and one that leads nowhere, with which Kalico does not start
is_left() {
    if [ -L "$klipper/$1" ] && [ ! -e "$klipper/$1" ]; then
        return 0
    fi
    is_chosen "$1" && { [ "$1" != "$SHARED" ] || ! is_folder_needed; } &&
        { is_ours "$1" || { [ -z "$uninstall" ] && is_of_project "$1"; }; }
}

# Whether a module that stays needs the folder
is_folder_needed() {
    local place
    for place in $(every_place); do
        is_chosen "$place" || ! is_ours "$place" || return 0
    done
    return 1
}

# Whether it, or a package of that name, is part of Klipper
is_tracked() {
    [[ $tracked = *$'\n'"$1"$'\n'* || $tracked = *$'\n'"${1%.py}"[/$'\n']* ]]
}

# A link into this checkout, also one to a file that is gone
is_ours() {
    [ -L "$klipper/$1" ] && [[ $(readlink -f -- "$klipper/$1") = "$here"/* ]]
}

# other_checkout PLACE: that of this project which a link leads to, if not this one
other_checkout() {
    local dir
    [ -L "$klipper/$1" ] && [ -e "$klipper/$1" ] && ! is_ours "$1" || return 0
    dir=$(dirname -- "$(readlink -f -- "$klipper/$1")")
    # In klippy/extras, where somebody may keep a file, the folder is a link
    [ ! -d "$dir/${SHARED##*/}" ] || [ -L "$dir/${SHARED##*/}" ] || say "$dir"
}

is_of_project() { is_ours "$1" || [ -n "$(other_checkout "$1")" ]; }

# A link to a file that is gone is of use to nobody
is_foreign() { [ -e "$klipper/$1" ] && ! is_of_project "$1"; }

set_up_links() {
    local place emptied=""
    [ -n "$uninstall" ] || check_one_checkout
    for place in $(every_place); do
        if is_wanted "$place"; then
            link "$place"
        elif is_left "$place"; then
            unlink_place "$place" "$(strange_target "$place")"
            emptied+=" $place"
        fi
    done
    if [ -n "$uninstall" ]; then
        name_backups
    else
        check_kalico
    fi
    [ -z "$has_git" ] || set_up_exclude "$emptied"
}

# Each Klipper in which links into this checkout stay when some are taken away
still_linked() {
    local other
    ! is_folder_needed || say "$klipper"
    for other in "$HOME/klipper" "$HOME/kalico"; do
        [ "$other" -ef "$klipper" ] ||
            [[ $(readlink -m -- "$other/$SHARED") != "$here"/* ]] || say "$other"
    done
}

# Where a link leads, if that is not this checkout
strange_target() {
    local target
    target=$(readlink -m -- "$klipper/$1")
    [[ $target = "$here"/* ]] || say "which led to $target"
}

# unlink_place PLACE DETAIL
unlink_place() {
    needs_writable "$klipper/${1%/*}"
    ! is_tracked "$1" || note "$1 is part of this Klipper. To restore it:" \
        "git -C '$klipper' checkout -- '$1'"
    change rm -- "$klipper/$1"
    report "Removing ${1##*/} from ${1%/*}" "${2:-}"
    links_changed=1
}

# Two versions side by side fail in the middle of a command: all modules come
# from the checkout that the folder comes from.
check_one_checkout() {
    local place other found="" unnamed=""
    for place in $(every_place); do
        other=$(other_checkout "$place")
        [ -n "$other" ] || continue
        is_chosen "$place" || unnamed=1
        ! is_chosen "$place" || [ -z "$force" ] || continue
        problem "$CONFLICT" "$klipper/$place is a link to another checkout of" \
            "this project, $other; its version and this one cannot be mixed"
        found=1
    done
    [ -z "$found" ] || explain "To change all of them to this checkout:" \
        "--force${unnamed:+, without --modules}"
}

# What --force has put aside
name_backups() {
    local name dir file conf
    for name in $MODULES "${SHARED##*/}"; do
        for dir in klippy/extras klippy/plugins; do
            for file in "$klipper/$dir/$name".bak-* \
                "$klipper/$dir/$name".py.bak-*; do
                [ ! -e "$file" ] || note "$file was kept when ours came; it is" \
                    "yours to rename or remove"
            done
        done
    done
    for conf in "${every_conf[@]}"; do
        for file in "$conf".bak-*; do
            [ ! -e "$file" ] || note "$file is an old text of moonraker.conf"
        done
    done
}

link() {
    local file="$klipper/$1" name=${1##*/} kept detail=""
    local action="Linking $name into ${1%/*}"
    if is_tracked "$1"; then
        problem "$CONFLICT" "$1 is part of this Klipper, and replacing it" \
            "would block Klipper updates; leave it out with --modules"
        return 0
    elif is_ours "$1" && [ "$file" -ef "$here/$name" ]; then
        tell "$action... [OK, already linked]"
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
    local file="$klipper/$1" name=${1##*/}
    if [ -L "$file" ]; then
        problem "$CONFLICT" "$file belongs to somebody else: it is a link to" \
            "$(readlink -f -- "$file")"
    else
        problem "$CONFLICT" "$file is no link, so this script has not made it"
    fi
    explain "$(difference "$name")"
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

# Kalico does not start with two modules of one name, unless it is told to.
check_kalico() {
    local name place shipped="" others="" lacking where
    [ "$folder" = klippy/plugins ] || return 0
    for name in $modules; do
        place=klippy/extras/$name.py
        if is_tracked "$place"; then
            shipped+="${shipped:+ and }$name"
        elif is_foreign "$place" && [ -n "$force" ]; then
            put_aside "$place"
        elif is_foreign "$place"; then
            refuse_to_replace "$place"
        else
            others+="${others:+ }$name"
        fi
    done
    [ -n "$shipped" ] || return 0
    lacking=$(printers_without_override)
    [ -n "$lacking" ] || return 0
    where=${lacking//$'\n'/ and to }
    if [ -n "$force" ]; then
        note "Kalico ships its own $shipped, and does not start beside ours" \
            "before [danger_options] with allow_plugin_override: True is added" \
            "to $where"
        return 0
    fi
    problem "$CONFLICT" "Kalico ships its own $shipped, and will not start" \
        "beside ours; first add to $where:"
    printf '\n[danger_options]\nallow_plugin_override: True\n\n' >&2
    explain "Then run this again, with -m if one of these is of another Klipper," \
        "which would not start with it; --force links in any case." \
        "${others:+Without it: --modules \"$others\"}"
}

# put_aside PLACE: a module of somebody else that ours, linked elsewhere, stands for
put_aside() {
    local file="$klipper/$1" kept detail
    needs_writable "${file%/*}"
    note "$(difference "${1##*/}")"
    if [ -L "$file" ]; then
        detail="which led to $(readlink -m -- "$file")"
        change rm -- "$file"
    else
        kept=$(backup_name "$file")
        detail="kept as ${kept##*/}"
        change mv -- "$file" "$kept"
    fi
    report "Removing ${1##*/} from ${1%/*}" "$detail"
    links_changed=1
}

# The printer.cfg of each printer that does not let plugins replace what Kalico
# ships, in itself or in what it includes
printers_without_override() {
    local conf cfg value files=()
    # Another one may be of another Klipper, which does not start with that option
    for conf in "${confs[@]}"; do
        files+=("${conf%/*}/printer.cfg")
    done
    [ "${#given_confs[@]}" -gt 0 ] ||
        files+=("$HOME"/*_data/config/printer.cfg
            "$HOME"/klipper_config/{,*/}printer.cfg)
    mapfile -t files < <(each_once "${files[@]}")
    [ "${#files[@]}" -gt 0 ] || say "printer.cfg"
    for cfg in "${files[@]}"; do
        value=$(setting "$cfg" danger_options allow_plugin_override)
        [[ ${value,,} =~ ^(true|yes|on|1)$ ]] || say "$cfg"
    done
}

# set_up_exclude REMOVED: git's list of files that are not Klipper's. If it
# cannot be written, git shows what is harmless.
set_up_exclude() {
    local file place wanted=() ignored="" new=""
    file=$(git -C "$klipper" rev-parse --git-path info/exclude)
    [[ $file = /* ]] || file="$klipper/$file"
    for place in $(every_place); do
        ! is_wanted "$place" || wanted+=("$place")
    done
    # It fails where none is
    [ "${#wanted[@]}" -eq 0 ] ||
        ignored=$(git -C "$klipper" check-ignore -- "${wanted[@]}") || true
    for place in "${wanted[@]}"; do
        [[ $'\n'$ignored$'\n' = *$'\n'"$place"$'\n'* ]] ||
            new+=$'\n'"/$place"
    done
    if [ -n "$new" ]; then
        if change append "$MARK$new" "$file" 2>/dev/null; then
            report "Excluding the links from git status" "in $file"
        else
            note "cannot write to $file; git will list the links as new files"
        fi
    fi
    [ -z "$1" ] || [ ! -f "$file" ] || change clean_exclude "$file" "$1"
}

# clean_exclude FILE PLACES: the lines of links that are gone, and our mark, with the
# empty line before it, where no line follows
# shellcheck disable=SC2329 # called by change
clean_exclude() {
    awk -v gone="$2 " -v mark="$MARK" '
        /^\// && index(gone, " " substr($0, 2) " ") { next }
        { line[++n] = $0 }
        END {
            for (i = 1; i <= n; i++) {
                if (index(line[i], mark) == 1 && line[i + 1] !~ /^\//) {
                    if (kept && !length(shown[kept])) kept--
                    continue
                }
                shown[++kept] = line[i]
            }
            for (i = 1; i <= kept; i++) print shown[i]
        }' "$1" >"$scratch/new"
    replace "$1" 2>/dev/null || true
}
