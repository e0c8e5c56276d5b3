//! Files in `configs/deploy/`: rules of udev, units of systemd, limits, users and modules. Each line must be valid in its format.
//! Tests of the program also run the tools of the machine on them, where they exist.

/// The error in a file of one of these formats; none for other formats.
pub fn check(path: &str, text: &str) -> Option<Result<(), String>> {
    let name = path.strip_prefix("configs/deploy/")?;
    let lines = |judge: fn(&str) -> Result<(), String>| each_line(text, judge);
    Some(match name.rsplit('.').next()? {
        "rules" => lines(udev_rule),
        "service" => unit(text),
        "conf" if name.ends_with("-sysusers.conf") => lines(user_or_group),
        "conf" if name.ends_with("-modules.conf") => lines(module),
        "conf" => lines(limit),
        _ => return None,
    })
}

/// Checks each line that is neither empty nor a comment; at least one is needed.
fn each_line(text: &str, judge: fn(&str) -> Result<(), String>) -> Result<(), String> {
    let mut judged = 0;
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
    {
        judge(line).map_err(|problem| format!("line {}: {problem}", index + 1))?;
        judged += 1;
    }
    if judged == 0 { Err("has no line with content".to_owned()) } else { Ok(()) }
}

/// Keys of udev(7) that only compare, that only assign, and that do both.
const MATCHES: [&str; 12] = [
    "ACTION",
    "DEVPATH",
    "KERNEL",
    "KERNELS",
    "SUBSYSTEM",
    "SUBSYSTEMS",
    "DRIVER",
    "DRIVERS",
    "ATTRS",
    "TAGS",
    "TEST",
    "RESULT",
];
const ASSIGNS: [&str; 8] = ["OWNER", "GROUP", "MODE", "RUN", "LABEL", "GOTO", "IMPORT", "OPTIONS"];
const BOTH: [&str; 6] = ["NAME", "SYMLINK", "ATTR", "ENV", "TAG", "PROGRAM"];
/// Keys with a name in braces.
const NAMED: [&str; 4] = ["ATTR", "ATTRS", "ENV", "IMPORT"];

/// `KEY=="value", KEY{name}="value"`: at least one comparison and one assignment.
fn udev_rule(line: &str) -> Result<(), String> {
    let (mut rest, mut compares, mut assigns) = (line.trim(), 0, 0);
    while !rest.is_empty() {
        let (head, tail) = rest.split_once('"').ok_or_else(|| format!("`{rest}` has no value in quotes"))?;
        let (value, tail) = tail.split_once('"').ok_or_else(|| format!("`{rest}` has no second quote"))?;
        let at = head.find(['=', '!', '+', '-', ':']).ok_or_else(|| format!("`{head}` has no operator"))?;
        let (key, operator) = head.split_at(at);
        let (key, name) = match key.split_once('{') {
            Some((key, name)) => (key, Some(name.strip_suffix('}').ok_or_else(|| format!("`{key}` has no }}"))?)),
            None => (key, None),
        };
        let is_compared = matches!(operator, "==" | "!=");
        if !is_compared && !matches!(operator, "=" | "+=" | "-=" | ":=") {
            return Err(format!("`{operator}` is not an operator"));
        }
        let known = if is_compared { MATCHES.contains(&key) } else { ASSIGNS.contains(&key) };
        if !known && !BOTH.contains(&key) {
            return Err(format!("`{key}{operator}` is not allowed"));
        }
        if NAMED.contains(&key) != name.is_some_and(|name| !name.is_empty()) && key != "TEST" {
            return Err(format!("`{key}`: only {NAMED:?} have a name in braces"));
        }
        if key == "MODE" && u32::from_str_radix(value, 8).is_err() {
            return Err(format!("the mode {value:?} is not octal"));
        }
        if is_compared {
            compares += 1
        } else {
            assigns += 1
        }
        rest = tail.trim_start();
        if let Some(more) = rest.strip_prefix(',') {
            rest = more.trim_start();
            if rest.is_empty() {
                return Err("ends with a comma".to_owned());
            }
        } else if !rest.is_empty() {
            return Err(format!("a comma is missing before `{rest}`"));
        }
    }
    if compares == 0 || assigns == 0 {
        return Err("a rule needs a comparison and an assignment".to_owned());
    }
    Ok(())
}

/// Sections with `Key=value` lines; a service starts a program by its absolute path.
fn unit(text: &str) -> Result<(), String> {
    let (mut section, mut sections, mut starts) = (String::new(), Vec::new(), 0);
    for line in text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            section = name.to_owned();
            sections.push(section.clone());
            continue;
        }
        let (key, value) = line.split_once('=').ok_or_else(|| format!("`{line}` is not Key=value"))?;
        let is_key =
            key.starts_with(|c: char| c.is_ascii_uppercase()) && key.chars().all(|c| c.is_ascii_alphanumeric());
        if !is_key || section.is_empty() {
            return Err(format!("`{line}` is not Key=value in a section"));
        }
        if key == "ExecStart" {
            starts += 1;
            if section != "Service" || !(value.starts_with('/') || value.starts_with("pb3dp ")) {
                return Err(format!("`{line}`: an absolute path or pb3dp, in [Service]"));
            }
        }
    }
    if sections != ["Unit", "Service", "Install"] || starts != 1 {
        return Err(format!(
            "has the sections {sections:?} and starts {starts} programs: [Unit], [Service], [Install], one program"
        ));
    }
    Ok(())
}

/// limits.conf(5): `@group - item value`.
fn limit(line: &str) -> Result<(), String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words[..] {
        [_, "-" | "soft" | "hard", "rtprio" | "memlock" | "nice" | "nofile" | "core", value]
            if value == "unlimited" || value.parse::<i64>().is_ok() =>
        {
            Ok(())
        }
        _ => Err(format!("`{line}` is not `@group - item value`")),
    }
}

/// sysusers.d(5): `g name id`, `u name id "description"`, `m user group`.
fn user_or_group(line: &str) -> Result<(), String> {
    let plain = line.split('"').next().unwrap_or_default();
    let words: Vec<&str> = plain.split_whitespace().collect();
    match words[..] {
        ["g" | "u" | "m", _, _] if line.matches('"').count().is_multiple_of(2) => Ok(()),
        _ => Err(format!("`{line}` is not `g name id`, `u name id \"description\"` or `m user group`")),
    }
}

/// modules-load.d(5): one name.
fn module(line: &str) -> Result<(), String> {
    let is_name = line.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c));
    if is_name { Ok(()) } else { Err(format!("`{line}` is not the name of a module")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(name: &str, text: &str) -> Result<(), String> {
        check(&format!("configs/deploy/{name}"), text).expect("a known ending")
    }

    #[test]
    fn broken_rules_are_caught() {
        let good = "SUBSYSTEM==\"tty\", ATTR{idVendor}!=\"0403\", ENV{A}=\"1\", SYMLINK+=\"x/y\", MODE=\"0660\"";
        assert_eq!(of("a.rules", &format!("# note\n\n{good}\n")), Ok(()));
        for (from, to) in [
            ("SUBSYSTEM==", "SUBSYSTEM="),
            ("SUBSYSTEM==", "SUBSYSTM=="),
            ("MODE=", "MODE=="),
            ("\"0660\"", "\"0690\""),
            ("{idVendor}", ""),
            ("{idVendor}", "{idVendor"),
            ("SYMLINK+=", "SYMLINK{a}+="),
            ("SYMLINK+=", "SYMLINK++"),
            ("\"tty\",", "\"tty\""),
            ("\"0660\"", "\"0660"),
            ("\"0660\"", "\"0660\","),
        ] {
            let broken = good.replace(from, to);
            assert!(of("a.rules", &broken).is_err_and(|problem| problem.starts_with("line 1: ")), "{broken}");
        }
        assert!(of("a.rules", "MODE=\"0660\"").is_err() && of("a.rules", "KERNEL==\"a\"").is_err());
        assert!(of("a.rules", "# nothing\n").is_err());
    }

    #[test]
    fn broken_units_are_caught() {
        let good = "[Unit]\nDescription=A\n[Service]\nExecStart=/bin/a --b\n[Install]\nWantedBy=c\n";
        assert_eq!(of("a@.service", good), Ok(()));
        for (from, to) in [
            ("/bin/a", "a"),
            ("[Install]\n", ""),
            ("ExecStart=", "#"),
            ("Description=A", "Description A"),
            ("[Unit]\n", ""),
            ("WantedBy=c", "ExecStart=/bin/c"),
        ] {
            assert!(of("a@.service", &good.replace(from, to)).is_err(), "{from} -> {to}");
        }
    }

    #[test]
    fn broken_lists_are_caught() {
        assert_eq!(of("90.conf", "@realtime - rtprio 99\n@realtime - memlock unlimited\n"), Ok(()));
        for bad in
            ["@realtime rtprio 99", "@realtime - rtpri 99", "@realtime - rtprio high", "@realtime always rtprio 9"]
        {
            assert!(of("90.conf", bad).is_err(), "{bad}");
        }
        assert_eq!(of("x-sysusers.conf", "g a -\nu b - \"B b\"\nm b a\n"), Ok(()));
        for bad in ["x a -", "g a", "u b - \"B"] {
            assert!(of("x-sysusers.conf", bad).is_err(), "{bad}");
        }
        assert_eq!(of("x-modules.conf", "com20020_pci\n"), Ok(()));
        assert!(of("x-modules.conf", "com20020_pci, arc\n").is_err());
    }

    #[test]
    fn other_files_are_none_of_these() {
        assert!(check("configs/a.rules", "").is_none() && check("configs/deploy/a.txt", "").is_none());
    }
}
