"""What a shell is told: to ask `jaxtube --complete LINE`, which answers with one word a line. Where
there are none the shell completes names of files."""

BASH = """\
_jaxtube() {
    local line=${COMP_LINE:0:COMP_POINT}
    local typed=${line##* }
    local IFS=$'\\n'
    COMPREPLY=($("$1" --complete "$line" 2>/dev/null))
    # Bash takes what stands before "=" for a word of its own, and completes the rest.
    if [[ $typed == *=* && $COMP_WORDBREAKS == *=* ]]; then
        COMPREPLY=("${COMPREPLY[@]#"${typed%=*}="}")
    fi
    if [[ ${COMPREPLY[0]} == *[.=] ]]; then
        compopt -o nospace 2>/dev/null  # bash 4
    fi
}
complete -o default -F _jaxtube jaxtube
"""

ZSH = """\
#compdef jaxtube
_jaxtube() {
    local -a found
    found=(${(f)"$($words[1] --complete "${(j: :)words[1,CURRENT]}" 2>/dev/null)"})
    if (( ! $#found )); then
        _files
        return
    fi
    compadd -Q -S '' -- ${(M)found:#*[.=]}
    compadd -Q -- ${found:#*[.=]}
}
compdef _jaxtube jaxtube
"""

FISH = """\
complete -c jaxtube -a '(jaxtube --complete (commandline -cp | string collect) 2>/dev/null)'
"""

SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}
"""The script of each shell."""
