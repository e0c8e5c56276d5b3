//! Seeds of a run: one number, `run.seed` or `--seed`, from which every consumer of random numbers derives its own seed.

use pb3dp_estimation_core::rng::SplitMix64;

use super::{Leader, Setup};

/// A consumer of random numbers in a run.
///
/// The discriminants are part of the derivation: keep them, and give a new stream the next number, so that existing seeds keep
/// their meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// Textures and shapes of target, backdrop and room.
    Scene = 0,
    /// Noise of both image sensors; the renderer hashes left and right into it.
    SensorNoise = 1,
    /// Noise and initial pose error of the geometric tracker.
    GeometricNoise = 2,
    /// Frame pairs that the faults of the simulated cameras affect.
    CameraFaults = 3,
    /// Genetic algorithm of the method `published`, the only tracker with random numbers.
    PublishedSearch = 4,
    /// Random faults of the emulated arm that carries the cameras.
    VsEmulation = 5,
    /// Random faults of the emulated arm that carries the target.
    TcEmulation = 6,
}

impl Stream {
    /// Every stream.
    pub const ALL: [Self; 7] = [
        Self::Scene,
        Self::SensorNoise,
        Self::GeometricNoise,
        Self::CameraFaults,
        Self::PublishedSearch,
        Self::VsEmulation,
        Self::TcEmulation,
    ];

    /// The seed of this stream in the run with the seed `run`.
    ///
    /// Two rounds of SplitMix64 (Steele, Lea and Flood, 2014). A round is a bijection of 64 bits, so no two derived streams of a
    /// run are equal. The first round comes before the number of the stream, so that runs with neighbouring seeds share no stream.
    ///
    /// The scene uses the seed of the run unchanged: tests, benchmarks and images without a run also show the target of seed 1.
    pub fn of(self, run: u64) -> u64 {
        match self {
            Self::Scene => run,
            _ => SplitMix64::new(SplitMix64::new(run).next_u64() ^ self as u64).next_u64(),
        }
    }

    /// As [`Self::of`], for a consumer of 32 bits; all 64 bits of the seed contribute.
    pub fn narrow(self, run: u64) -> u32 {
        let seed = self.of(run);
        (seed ^ (seed >> 32)) as u32
    }
}

impl Setup {
    /// The same setup with another seed for every stream.
    pub fn reseed(&mut self, seed: u64) {
        let published = &mut self.estimator.published.rmga.seed;
        // Keeps the offset of the published search from the file.
        let added = published.wrapping_sub(Stream::PublishedSearch.of(self.seed));
        *published = Stream::PublishedSearch.of(seed).wrapping_add(added);
        self.seed = seed;
        self.seed_parts();
    }

    /// A new setup, whose parts have no seeds yet.
    pub(super) fn seeded(mut self) -> Self {
        self.seed_parts();
        self
    }

    /// Sets the seed of every part from that of the run; the published search adds the value of the file.
    fn seed_parts(&mut self) {
        let run = self.seed;
        if let Some(world) = self.world.as_mut() {
            world.scene.seed = Stream::Scene.narrow(run);
            world.faults.seed = Stream::CameraFaults.narrow(run);
            world.sensor_seed = Stream::SensorNoise.narrow(run);
        }
        let geometric = Stream::GeometricNoise.narrow(run);
        if let Some(config) = &mut self.geometric {
            config.seed = geometric;
        }
        if let Leader::Geometric(config) = &mut self.leader {
            config.seed = geometric;
        }
        self.rig.arms.vs.emulation_seed = Stream::VsEmulation.of(run);
        self.rig.arms.tc.emulation_seed = Stream::TcEmulation.of(run);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::super::read_setup;
    use super::*;

    const RUNS: [u64; 8] = [0, 1, 2, 41, u32::MAX as u64 - 1, u32::MAX as u64, 1 << 40, u64::MAX - 1];

    fn setup() -> Setup {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let mut setup = read_setup(&configs.join("sim.toml")).unwrap();
        setup.leader = Leader::Geometric(setup.geometric.unwrap());
        setup
    }

    /// The seeds that the parts of a setup hold, and the one that the sensors get at wiring.
    fn handed_out(setup: &Setup) -> Vec<u64> {
        let Leader::Geometric(leader) = setup.leader else { panic!("{:?} leads", setup.leader) };
        assert_eq!(Some(leader.seed), setup.geometric.map(|config| config.seed), "it is one tracker");
        let narrow = [
            setup.world.as_ref().unwrap().scene.seed,
            Stream::SensorNoise.narrow(setup.seed),
            leader.seed,
            setup.world.as_ref().unwrap().faults.seed,
        ]
        .map(u64::from);
        let wide =
            [setup.estimator.published.rmga.seed, setup.rig.arms.vs.emulation_seed, setup.rig.arms.tc.emulation_seed];
        narrow.into_iter().chain(wide).collect()
    }

    /// Whether all are different.
    fn differ(seeds: impl IntoIterator<Item = u64>) -> bool {
        let mut known = BTreeSet::new();
        seeds.into_iter().all(|seed| known.insert(seed))
    }

    #[test]
    fn no_two_streams_are_equal_within_a_run_or_between_runs_with_neighbouring_seeds() {
        for (index, stream) in Stream::ALL.into_iter().enumerate() {
            assert_eq!(stream as usize, index, "{stream:?} is numbered and listed");
        }
        for run in RUNS {
            let pairs = || [run, run + 1].into_iter().flat_map(|run| Stream::ALL.map(|stream| (stream, run)));
            assert!(differ(pairs().map(|(stream, run)| stream.of(run))), "run {run}: 64 bits");
            assert!(differ(pairs().map(|(stream, run)| u64::from(stream.narrow(run)))), "run {run}: 32 bits");
        }
        assert!(differ(RUNS.into_iter().flat_map(|run| Stream::ALL.map(|stream| stream.of(run)))));
    }

    /// Computed from the published algorithm of SplitMix64 by another program.
    #[test]
    fn a_seed_keeps_its_streams_from_version_to_version() {
        let expected = [
            1,
            0xE9FD_6049_D65A_F21E,
            0xBCD9_DBB4_9673_066B,
            0x86D6_FD95_3217_AE03,
            0xDEF4_34E3_9805_1D63,
            0xB144_1D25_4BD8_6CD7,
            0x309F_81A5_EBE9_A7F2,
        ];
        assert_eq!(Stream::ALL.map(|stream| stream.of(1)), expected);
        assert_eq!((Stream::Scene.narrow(1), Stream::Scene.narrow(1 << 32 | 6)), (1, 7));
    }

    #[test]
    fn another_seed_of_the_run_changes_the_seed_of_every_part_camera_faults_too() {
        let mut setup = setup();
        let of_file = handed_out(&setup);
        assert_eq!(of_file.len(), Stream::ALL.len());
        for seed in [0, 2, u64::from(u32::MAX)] {
            setup.reseed(seed);
            let reseeded = handed_out(&setup);
            assert!(differ(of_file.iter().chain(&reseeded).copied()), "seed {seed}: {of_file:?}, {reseeded:?}");
        }
        setup.reseed(1);
        assert_eq!(handed_out(&setup), of_file, "--seed 1 is seed = 1 of the file");
    }

    #[test]
    fn what_the_file_adds_to_the_seed_of_the_published_search_stays_added() {
        let mut setup = setup();
        setup.estimator.published.rmga.seed = Stream::PublishedSearch.of(setup.seed).wrapping_add(7);
        setup.reseed(5);
        assert_eq!(setup.estimator.published.rmga.seed, Stream::PublishedSearch.of(5).wrapping_add(7));
    }
}
