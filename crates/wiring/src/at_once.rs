//! Two pieces of work on two processors.

use std::thread::{Builder, scope};

/// Stack of the thread that is started. A program that keeps its memory from being swapped out has all of it written at each start;
/// rendering takes less than a tenth of it.
const STACK_BYTES: usize = 512 << 10;

/// Calls both at the same time: `second` on a thread that is started for it, or afterwards where the system gives none.
pub fn at_once(first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
    let mut is_second_done = false;
    scope(|scope| {
        let thread = Builder::new().name("right eye".to_owned()).stack_size(STACK_BYTES);
        is_second_done = thread.spawn_scoped(scope, &mut *second).is_ok();
        first();
    });
    if !is_second_done {
        second();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn both_are_called_once_and_at_the_same_time() {
        // Each waits for the other one: one after the other they would never end.
        let (met, mut firsts, mut seconds) = (Barrier::new(2), 0, 0);
        let mut first = || {
            met.wait();
            firsts += 1;
        };
        at_once(&mut first, &mut || {
            met.wait();
            seconds += 1;
        });
        assert_eq!((firsts, seconds), (1, 1));
    }
}
