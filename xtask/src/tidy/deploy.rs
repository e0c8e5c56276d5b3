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

/// Keys of udev(7) that a rule may compare, and those that it may assign; `{}` stands for a name in braces.
const COMPARED: [&str; 10] =
    ["ACTION", "KERNEL", "KERNELS", "SUBSYSTEM", "SUBSYSTEMS", "DRIVER", "ATTR{}", "ATTRS{}", "ENV{}", "TEST"];
const ASSIGNED: [&str; 8] = ["OWNER", "GROUP", "MODE", "SYMLINK", "TAG", "RUN", "ATTR{}", "ENV{}"];

/// `KEY=="value", KEY{name}="value"`: at least one comparison and one assignment.
fn udev_rule(line: &str) -> Result<(), String> {
    let (mut compares, mut assigns) = (0, 0);
    for item in line.split(',').map(str::trim) {
        let (head, value) = item.split_once("=\"").ok_or_else(|| format!("`{item}` has no value in quotes"))?;
        let value = value.strip_suffix('"').filter(|value| !value.contains('"'));
        let value = value.ok_or_else(|| format!("`{item}`: one value in quotes, then a comma"))?;
        let key = head.trim_end_matches(['=', '!', '+', '-', ':']);
        let is_compared = match &head[key.len()..] {
            "=" | "!" => true,
            "" | "+" | "-" | ":" => false,
            other => return Err(format!("`{other}=` is not an operator")),
        };
        let named = match key.split_once('{') {
            Some((start, name)) if name.len() > 1 && name.ends_with('}') => format!("{start}{{}}"),
            _ => key.to_owned(),
        };
        if !if is_compared { &COMPARED[..] } else { &ASSIGNED[..] }.contains(&named.as_str()) {
            return Err(format!("`{head}=` is not allowed"));
        }
        if key == "MODE" && u32::from_str_radix(value, 8).is_err() {
            return Err(format!("the mode {value:?} is not octal"));
        }
        *if is_compared { &mut compares } else { &mut assigns } += 1;
    }
    if compares == 0 || assigns == 0 { Err("needs a comparison and an assignment".to_owned()) } else { Ok(()) }
}

/// Sections with `Key=value` lines. A test of the program checks what the unit starts.
fn unit(text: &str) -> Result<(), String> {
    let mut sections = Vec::new();
    for line in text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            sections.push(name);
            continue;
        }
        let key = line.split_once('=').map_or("", |(key, _)| key);
        let is_key = key.starts_with(|c: char| c.is_ascii_uppercase()) && key.chars().all(char::is_alphanumeric);
        if !is_key || sections.is_empty() {
            return Err(format!("`{line}` is not Key=value in a section"));
        }
    }
    if sections == ["Unit", "Service", "Install"] { Ok(()) } else { Err(format!("has the sections {sections:?}")) }
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
        for (from, to) in
            [("[Install]\n", ""), ("Description=A", "Description A"), ("[Unit]\n", ""), ("WantedBy=c", "wanted by=c")]
        {
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
