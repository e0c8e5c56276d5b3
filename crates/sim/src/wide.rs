//! Selection of the vector kernels of the renderer and the sensor. All give the same bits; a test of the renderer compares them.

use pb3dp_computing::cpu::Kernels;

/// The fastest kernels of this processor (or those selected by a test).
pub(crate) fn kernels() -> Kernels {
    #[cfg(test)]
    if let Some(chosen) = tests::CHOSEN.with(std::cell::Cell::get) {
        return chosen;
    }
    Kernels::best()
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;

    use super::*;

    thread_local! {
        pub(crate) static CHOSEN: Cell<Option<Kernels>> = const { Cell::new(None) };
    }

    /// Runs `f` with these kernels.
    pub(crate) fn with<T>(kernels: Kernels, f: impl FnOnce() -> T) -> T {
        CHOSEN.with(|chosen| chosen.set(Some(kernels)));
        let result = f();
        CHOSEN.with(|chosen| chosen.set(None));
        result
    }
}
