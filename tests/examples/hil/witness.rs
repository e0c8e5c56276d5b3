//! How late the machine itself is: threads that do nothing but sleep, before all others on every processor.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, available_parallelism};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use pb3dp_arm_pa10::io::arm::{Jitter, JitterMeter};
use pb3dp_arm_pa10::io::realtime::{Realtime, enter, now, sleep_until};

/// Above every thread of ours: only the system and the machine below it hold these threads up.
const PRIORITY: u8 = 90;
/// Time from one waking to the next.
pub const PERIOD: Duration = Duration::from_millis(1);

/// Threads that see how late they wake.
pub struct Witness {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Jitter>>,
}

impl Witness {
    /// One thread on each processor, from now on.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start() -> Result<Self> {
        let mut witness = Self { is_over: Arc::default(), threads: Vec::new() };
        for cpu in 0..available_parallelism()?.get() {
            let is_over = Arc::clone(&witness.is_over);
            let thread = std::thread::Builder::new().name("witness".to_owned());
            witness.threads.push(thread.spawn(move || watch(cpu, &is_over)).context("a thread that watches")?);
        }
        Ok(witness)
    }

    /// What the processor saw that was held up longest.
    ///
    /// # Errors
    /// If a thread failed.
    pub fn end(self) -> Result<Jitter> {
        self.is_over.store(true, Ordering::Relaxed);
        let mut seen = Vec::new();
        for thread in self.threads {
            seen.push(thread.join().map_err(|_| anyhow!("a thread that watches the machine has failed"))?);
        }
        seen.into_iter().max_by_key(|jitter| jitter.max).context("no processor was watched")
    }
}

fn watch(cpu: usize, is_over: &AtomicBool) -> Jitter {
    for shortfall in enter(&Realtime { priority: Some(PRIORITY), locks_memory: false, cpu: Some(cpu) }) {
        eprintln!("watching processor {cpu}: {shortfall}");
    }
    let meter = JitterMeter::default();
    while !is_over.load(Ordering::Relaxed) {
        let at = now() + PERIOD;
        sleep_until(at);
        meter.record(now().saturating_since(at));
    }
    meter.summary()
}
