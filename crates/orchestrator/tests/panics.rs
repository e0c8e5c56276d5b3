//! A thread that panics, and says more than a log holds, while standard error is a full pipe: it goes on to what it has to do, and
//! its text is written later.
//!
//! This program starts itself: the second process, with the argument `panics`, panics, and the first one observes it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::io::{BufRead, BufReader, PipeReader, Read, Write};
use std::panic::catch_unwind;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use libtest_mimic::{Arguments, Trial};
use pb3dp_orchestrator::{logging, panics};

/// More than wait to be written.
const LINES: usize = 20_000;

/// Far more than anything here takes.
const LONG: Duration = Duration::from_secs(30);

fn main() {
    if std::env::args().nth(1).as_deref() == Some("panics") {
        return panic_and_go_on();
    }
    let mut arguments = Arguments::from_args();
    arguments.test_threads = Some(1);
    let trial = |(name, test): (&'static str, fn())| {
        Trial::test(name, move || {
            test();
            Ok(())
        })
    };
    let tests: [(&str, fn()); 2] = [
        ("its_text_is_written_later", its_text_is_written_later),
        ("nobody_ever_reads_its_text", nobody_ever_reads_its_text),
    ];
    libtest_mimic::run(&arguments, tests.map(trial).into()).exit();
}

/// As the thread of an arm does: what follows the panic is its stop order.
fn panic_and_go_on() {
    let _log = logging::init(logging::LogFormat::Human, "info").unwrap();
    panics::install();
    let thread = std::thread::Builder::new().name("arm 7".into()).spawn(|| {
        assert!(catch_unwind(|| panic!("no such joint")).is_err());
        tracing::error!("the brakes do not answer");
        (0..LINES).for_each(|line| tracing::info!("line {line}"));
        let mut output = std::io::stdout();
        writeln!(output, "stopped").unwrap();
    });
    thread.unwrap().join().unwrap();
    let mut line = String::new();
    // Until the other side has looked.
    std::io::stdin().read_line(&mut line).unwrap();
}

struct Scene {
    child: Child,
    unread: PipeReader,
}

impl Scene {
    /// The other one, its standard error full, has panicked and gone on.
    fn begin() -> Self {
        let (unread, full) = std::io::pipe().unwrap();
        let mut filler = full.try_clone().unwrap();
        // Ends when nobody can read any more.
        std::thread::spawn(move || while filler.write_all(&[b'x'; 4096]).is_ok() {});
        std::thread::sleep(Duration::from_millis(200));
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.arg("panics").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(full);
        let mut child = command.spawn().unwrap();
        let (tell, messages) = channel();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            let mut line = String::new();
            output.read_line(&mut line).unwrap();
            tell.send(line)
        });
        let line = messages.recv_timeout(LONG).unwrap_or_else(|_| {
            child.kill().unwrap();
            panic!("the thread waits for its log")
        });
        assert_eq!(line, "stopped\n");
        Self { child, unread }
    }

    fn wait(mut self) {
        drop(self.child.stdin.take());
        let begin = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            if begin.elapsed() > LONG {
                self.child.kill().unwrap();
                panic!("the program waits for its log");
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

fn its_text_is_written_later() {
    let mut scene = Scene::begin();
    let begin = Instant::now();
    let (mut text, mut piece) = (String::new(), [0; 4096]);
    let parts = ["arm 7", "no such joint", "the brakes do not answer", "lines are missing in this log"];
    while !parts.iter().all(|part| text.contains(part)) {
        assert!(begin.elapsed() < LONG, "{}", &text[..text.len().min(2000)]);
        let count = scene.unread.read(&mut piece).unwrap();
        text.push_str(&String::from_utf8_lossy(&piece[..count]).replace('x', ""));
    }
    scene.wait();
}

fn nobody_ever_reads_its_text() {
    Scene::begin().wait();
}
