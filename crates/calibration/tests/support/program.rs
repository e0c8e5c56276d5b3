//! The program `pb3dp-calibrate`, as a user runs it.

use std::process::Command;

/// Output of the program.
pub struct Output {
    args: String,
    pub success: bool,
    /// Standard output, then standard error.
    pub text: String,
}

/// Runs the program with these arguments, given in parts.
pub fn calibrate(args: &[&[&str]]) -> Output {
    let args = args.concat();
    let output = Command::new(env!("CARGO_BIN_EXE_pb3dp-calibrate")).args(&args).output().expect("it starts");
    let text = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    println!("{text}");
    Output { args: args.join(" "), success: output.status.success(), text }
}

impl Output {
    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert!(self.success, "{}\n{}", self.args, self.text);
        self
    }

    #[track_caller]
    pub fn refused(self) -> Self {
        assert!(!self.success, "{}\n{}", self.args, self.text);
        self
    }

    #[track_caller]
    pub fn contains_all(&self, parts: &[&str]) {
        for part in parts {
            assert!(self.text.contains(part), "{part:?} is missing: {}\n{}", self.args, self.text);
        }
    }
}
