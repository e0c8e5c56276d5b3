//! `select` at the console: each selection travels with its command.

use std::path::PathBuf;

use pb3dp_geometry::ImageSize;

use super::*;
use crate::perception::TargetSource;
use crate::selection::Choice;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// A console with a prompt, both arms enabled, whose targets can be chosen.
struct Selecting {
    console: Console,
    typing: PipeWriter,
    answers: Receiver<String>,
    selections: Selections,
}

impl Selecting {
    fn new() -> Self {
        let selections = Selections::default();
        selections.set_target_of_setup(&TargetSource::Region(Region::Click { x: 7, y: 7 }));
        Self::of(selections)
    }

    fn of(selections: Selections) -> Self {
        let (written, answers) = channel();
        Self::writing_to(selections, Written(written), answers)
    }

    fn writing_to(selections: Selections, output: impl Write + Send + 'static, answers: Receiver<String>) -> Self {
        let targets = Some(ConsoleTargets { size: SIZE, selections: selections.clone() });
        let (lines, typing) = typed();
        let options = ConsoleOptions { targets, ..options() };
        let mut console = Console::start(Arc::new(VirtualClock::new()), lines, output, options).unwrap();
        console.listen(None, NOW);
        Self { console, typing, answers, selections }
    }

    fn types(&mut self, line: &str) {
        writeln!(self.typing, "{line}").unwrap();
    }

    /// A step, with the decision of the supervisor.
    fn step(&mut self, decision: &Decision) -> Option<OperatorCommand> {
        let request = command(&mut self.console);
        self.console.show(decision);
        request
    }

    /// Steps until a command is heard.
    fn hears(&mut self) -> OperatorCommand {
        let begin = Instant::now();
        loop {
            if let Some(request) = self.step(&decision()) {
                return request;
            }
            assert!(begin.elapsed() < Duration::from_secs(30));
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Reads answers until one contains this text.
    fn answers(&self, part: &str) -> String {
        let mut text = String::new();
        while !text.contains(part) || !text.ends_with('\n') {
            text += &self.answers.recv_timeout(Duration::from_secs(30)).unwrap_or_else(|_| panic!("{part}: {text}"));
        }
        text
    }

    /// What the estimation gets.
    fn taken(&self) -> Option<Region> {
        match self.selections.take()? {
            Choice::Marked(selection) => Some(selection.region),
            Choice::OfSetup => None,
        }
    }
}

fn is_at(region: &Option<Region>, left: i32) -> bool {
    matches!(region, Some(Region::Rectangle { x, .. }) if *x == left)
}

#[test]
fn a_selection_reaches_the_estimator_although_nobody_reads_the_answers() {
    let (unread, full) = pipe().unwrap();
    let selections = Selections::default();
    let (_, answers) = channel();
    let mut run = Selecting::writing_to(selections, full, answers);
    // More than a pipe and the answer queue hold.
    for _ in 0..4000 {
        run.types("what is the matter with you?");
    }
    run.types("select rect:400,120,60,50");
    assert_eq!(run.hears(), OperatorCommand::Select);
    assert!(is_at(&run.taken(), 400));
    drop(unread);
}

#[test]
fn start_waits_until_the_estimator_has_passed_on_the_selected_target() {
    let mut run = Selecting::new();
    run.types("select rect:400,120,60,50\nstart");
    assert_eq!(run.hears(), OperatorCommand::Select);
    wait_until(|| !run.console.commands.is_empty());
    assert_eq!(run.step(&decision()), None);
    run.answers("start refused: the target just selected is still being initialised");
    // The estimation has begun with it.
    assert!(is_at(&run.taken(), 400));
    run.types("start");
    wait_until(|| !run.console.commands.is_empty());
    assert_eq!(run.step(&decision()), None);
    // Its first estimate is passed on; the control thread has it one step later.
    assert!(run.taken().is_none());
    run.step(&decision());
    run.types("start");
    assert_eq!(run.hears(), OperatorCommand::Start);
}

#[test]
fn a_selection_that_hold_overtook_is_answered_and_forgotten() {
    for urgent in ["hold", "stop", "hold hand"] {
        let mut run = Selecting::new();
        run.types(&format!("select rect:400,120,60,50\n{urgent}\nselect rect:100,120,60,50"));
        // All three are read before the first step.
        wait_until(|| run.console.commands.slots() == 2);
        assert_eq!(run.hears().name(), urgent);
        assert_eq!(run.hears(), OperatorCommand::Select);
        run.answers(&format!("select not done: overtaken by {urgent}"));
        assert!(is_at(&run.taken(), 100), "{urgent}");
        // A plain select does not find the removed one either.
        run.types(&format!("select rect:400,120,60,50\n{urgent}"));
        let Shared { stop, hold, hold_hand, .. } = &*run.console.shared;
        wait_until(|| [stop, hold, hold_hand].iter().any(|slot| slot.number.load(Ordering::SeqCst) > 0));
        assert_eq!(run.hears().name(), urgent);
        run.types("select");
        assert_eq!(run.hears(), OperatorCommand::Select);
        assert!(matches!(run.selections.take(), Some(Choice::OfSetup)), "{urgent}");
    }
}

#[test]
fn a_plain_select_chooses_the_target_of_the_setup() {
    let mut run = Selecting::new();
    run.types("select rect:400,120,60,50");
    run.hears();
    assert!(is_at(&run.taken(), 400));
    run.types("select");
    assert_eq!(run.hears(), OperatorCommand::Select);
    assert!(matches!(run.selections.take(), Some(Choice::OfSetup)));
    // Where the setup has none, the target before is not kept in silence.
    let mut run = Selecting::of(Selections::default());
    run.types("select");
    run.answers("select refused: the setup names no target (camera.region); mark one in the left image");
    assert_eq!(run.step(&decision()), None);
}

#[test]
fn select_with_a_region_gives_the_target_once_the_supervisor_has_accepted_it() {
    let mut run = Selecting::new();
    let refused = Decision {
        refused: Some(Refusal { command: OperatorCommand::Select, because: RefusedFor::State(State::Tracking) }),
        ..decision()
    };
    run.types("select rect:400,120,60,50");
    wait_until(|| !run.console.commands.is_empty());
    assert_eq!(run.step(&refused), Some(OperatorCommand::Select));
    assert!(run.selections.take().is_none(), "the supervisor has refused it");
    run.types("select");
    run.hears();
    assert!(matches!(run.selections.take(), Some(Choice::OfSetup)), "a refused region is not used later");
    run.types("select rect:400,120,60,50");
    run.hears();
    assert!(is_at(&run.taken(), 400));
    run.answers("select: no change");
    for line in ["select rect:600,120,60,50", "select rect:1,2,3", "select circle:3"] {
        run.types(line);
        run.answers("select refused: ");
    }
}

/// A mask with one white block.
fn mask(folder: &Path, (width, height): (u32, u32)) -> PathBuf {
    let file = folder.join(format!("{width}.png"));
    image::GrayImage::from_fn(width, height, |u, _| image::Luma([if u < 50 { 255 } else { 0 }])).save(&file).unwrap();
    file
}

#[test]
fn a_mask_is_read_while_stop_and_hold_are_obeyed() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Selecting::new();
    run.types(&format!("select mask:{}", mask(folder.path(), (640, 480)).display()));
    assert_eq!(run.hears(), OperatorCommand::Select);
    assert!(matches!(run.taken(), Some(Region::Mask(_))));
    // Another size is refused by its header alone, and a folder at once.
    run.types(&format!("select mask:{}", mask(folder.path(), (1000, 800)).display()));
    run.answers("1000x800 pixels, but the left image has 640x480");
    run.types(&format!("select mask:{}", folder.path().display()));
    run.answers("select refused: ");
    assert_eq!(run.step(&decision()), None);
}

/// As long as a mask is being read, only what ends motion is obeyed.
#[test]
fn a_mask_that_is_never_read_delays_no_hold() {
    use OperatorCommand::{Hold, Select};
    let mut run = Selecting::new();
    // A file that does not answer: its thread never ends.
    run.console.shared.reading.store(1, Ordering::SeqCst);
    run.types("start");
    run.answers("start refused: the mask of the last select is still being read");
    run.types("select rect:100,120,60,50");
    run.answers("select refused: the mask of the last select is still being read");
    run.types("hold");
    assert_eq!(run.hears(), Hold);
    run.answers("select not done: overtaken by hold");
    run.types("select rect:100,120,60,50");
    assert_eq!(run.hears(), Select);
    assert!(is_at(&run.taken(), 100));
}

/// It would be read for ever.
#[cfg(unix)]
#[test]
fn a_device_is_no_mask_and_blocks_nothing() {
    let mut run = Selecting::new();
    run.types("select mask:/dev/zero");
    run.answers("it is a device, not a regular file");
    run.types("select mask:/dev/zero\nstop");
    assert_eq!(run.hears(), OperatorCommand::Stop);
}
