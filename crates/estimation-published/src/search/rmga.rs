//! The Real-time Multi-step Genetic Algorithm of the paper (section 3.2).
//!
//! Several generations per frame, each in the order evaluation, sorting, obsolete, crossover, mutation. The evolved population
//! is the start of the next frame, in which all individuals, including the elite, are evaluated again on the new image. The
//! paper states neither population nor rates; here they are parameters, with the defaults of the group's earlier work.

use std::cmp::Reverse;
use std::ops::RangeInclusive;

use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::ranges;

use super::chromosome::{BITS, Chromosome, Codec, Coding};
use super::{PlaneScore, REFUSED};

/// Mutation of newly bred individuals. The paper does not define it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mutation {
    /// One random bit is flipped with this probability.
    PerIndividual(f64),
    /// Each bit is flipped with this probability.
    PerBit(f64),
}

/// Parameters of the genetic algorithm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RmGaConfig {
    /// Number of individuals, 2 to 10000. Default 60.
    pub population: usize,
    /// Number of best individuals that survive and become parents, 2 to `population`; the others are made obsolete and refilled
    /// by crossover. Default 36 (60 %).
    pub survivors: usize,
    /// Number of best individuals that never mutate, 1 to `survivors`. Default 1.
    pub elite: usize,
    /// Generations per frame, 1 to 100000. Default 9.
    pub generations: usize,
    /// Mutation of all individuals except the elite. Default: each bit with 0.10 in the individuals refilled by crossover.
    pub mutation: Mutation,
    /// Whether survivors other than the elite mutate too. Default false.
    pub mutate_survivors: bool,
    /// Coding of numbers in the genes. Default Gray.
    pub coding: Coding,
    /// Seed of the random numbers. Default 1.
    pub seed: u64,
}

impl Default for RmGaConfig {
    fn default() -> Self {
        Self {
            population: 60,
            survivors: 36,
            elite: 1,
            generations: 9,
            mutation: Mutation::PerBit(0.10),
            mutate_survivors: false,
            coding: Coding::Gray,
            seed: 1,
        }
    }
}

impl RmGaConfig {
    ranges! {
        fn check_ranges "RM-GA ";
        population, POPULATION: usize = 2..=10_000;
        generations, GENERATIONS: usize = 1..=100_000;
    }

    /// Allowed rates of a mutation.
    pub const MUTATION_RATE: RangeInclusive<f64> = 0.0..=1.0;

    /// Allowed values of `survivors`.
    pub fn survivors_allowed(&self) -> RangeInclusive<usize> {
        2..=self.population.max(2)
    }

    /// Allowed values of `elite`.
    pub fn elite_allowed(&self) -> RangeInclusive<usize> {
        1..=self.survivors.max(1)
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), ranges::OutOfRange> {
        let rate = match self.mutation {
            Mutation::PerIndividual(rate) | Mutation::PerBit(rate) => rate,
        };
        self.check_ranges()?;
        ranges::check_range("RM-GA survivors", self.survivors, self.survivors_allowed())?;
        ranges::check_range("RM-GA elite", self.elite, self.elite_allowed())?;
        ranges::check_range("RM-GA mutation rate", rate, Self::MUTATION_RATE)
    }
}

/// State carried from frame to frame: the individuals and the state of the random number generator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Population {
    individuals: Vec<Chromosome>,
    rng: SplitMix64,
}

impl Population {
    /// Individuals distributed randomly over the whole search range.
    pub fn random(config: &RmGaConfig) -> Self {
        let mut rng = SplitMix64::new(config.seed);
        let individuals = (0..config.population).map(|_| Chromosome::from_bits(rng.below(1 << BITS))).collect();
        Self { individuals, rng }
    }

    /// The individuals; best first after an evolution.
    pub fn individuals(&self) -> &[Chromosome] {
        &self.individuals
    }

    /// Distributes all individuals randomly again, with the next random numbers; used after the target was lost.
    pub fn scatter(&mut self) {
        for individual in &mut self.individuals {
            *individual = Chromosome::from_bits(self.rng.below(1 << BITS));
        }
    }

    /// Moves every individual, for example by the known motion of the cameras since the last frame. Individuals that leave the
    /// search range are clamped to its end.
    pub fn shift(&mut self, codec: &Codec, motion: impl Fn(PlaneHypothesis) -> PlaneHypothesis) {
        for individual in &mut self.individuals {
            *individual = codec.encode(&motion(codec.decode(*individual)));
        }
    }
}

/// The best individual of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Best {
    /// The chromosome.
    pub chromosome: Chromosome,
    /// The hypothesis of the chromosome.
    pub hypothesis: PlaneHypothesis,
    /// Its score; [`REFUSED`] if no individual could be scored.
    pub score: i32,
}

impl Best {
    /// Whether any individual could be scored.
    pub fn is_scored(&self) -> bool {
        self.score != REFUSED
    }
}

/// The algorithm with its buffers; allocates only on creation.
#[derive(Clone, Debug)]
pub struct RmGa {
    config: RmGaConfig,
    codec: Codec,
    hypotheses: Vec<PlaneHypothesis>,
    scores: Vec<i32>,
    ranking: Vec<(Reverse<i32>, Chromosome)>,
}

impl RmGa {
    /// Creates the algorithm for a search range.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: RmGaConfig, range: SearchRange) -> Result<Self, EstimationError> {
        config.validate()?;
        range.validate()?;
        Ok(Self {
            config,
            codec: Codec::new(range, config.coding),
            hypotheses: vec![range.centre(); config.population],
            scores: vec![REFUSED; config.population],
            ranking: vec![(Reverse(REFUSED), Chromosome::default()); config.population],
        })
    }

    /// The parameters.
    pub fn config(&self) -> &RmGaConfig {
        &self.config
    }

    /// Conversion between chromosomes and hypotheses.
    pub fn codec(&self) -> &Codec {
        &self.codec
    }

    /// Processes one frame: the configured number of generations. The population stays as bred after the last sorting, with the
    /// best individual first: it is the start of the next frame.
    pub fn evolve(&mut self, population: &mut Population, score: &impl PlaneScore) -> Best {
        self.evolve_while(population, score, self.config.generations, &mut || true)
    }

    /// As [`Self::evolve`], for a given number of generations, while `may_continue` returns true before each generation; the
    /// first generation always runs.
    pub fn evolve_while(
        &mut self,
        population: &mut Population,
        score: &impl PlaneScore,
        generations: usize,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Best {
        self.fit(population);
        for generation in 0..generations {
            if generation > 0 && !may_continue() {
                break;
            }
            self.evaluate(&population.individuals, score);
            self.ranking.sort_unstable();
            self.breed(population);
        }
        let (Reverse(score), chromosome) = self.ranking[0];
        Best { chromosome, hypothesis: self.codec.decode(chromosome), score }
    }

    /// Resizes a population to the configured size.
    fn fit(&self, population: &mut Population) {
        let Population { individuals, rng } = population;
        individuals.resize_with(self.config.population, || Chromosome::from_bits(rng.below(1 << BITS)));
    }

    fn evaluate(&mut self, individuals: &[Chromosome], score: &impl PlaneScore) {
        for (hypothesis, individual) in self.hypotheses.iter_mut().zip(individuals) {
            *hypothesis = self.codec.decode(*individual);
        }
        score.score(&self.hypotheses, &mut self.scores);
        // Equal scores are ranked by their genes, so that the order is the same on every platform.
        for (rank, (individual, score)) in self.ranking.iter_mut().zip(individuals.iter().zip(&self.scores)) {
            *rank = (Reverse(*score), *individual);
        }
    }

    /// Obsolete, crossover, mutation.
    fn breed(&self, population: &mut Population) {
        let Population { individuals, rng } = population;
        let survivors = self.config.survivors;
        for (individual, rank) in individuals.iter_mut().zip(&self.ranking).take(survivors) {
            *individual = rank.1;
        }
        for k in survivors..individuals.len() {
            individuals[k] = self.cross(&individuals[..survivors], rng);
        }
        let first = if self.config.mutate_survivors { self.config.elite } else { survivors };
        for individual in &mut individuals[first..] {
            *individual = self.mutate(*individual, rng);
        }
    }

    /// Two-point crossover of two different parents.
    fn cross(&self, parents: &[Chromosome], rng: &mut SplitMix64) -> Chromosome {
        let count = parents.len() as u32;
        let mother = rng.below(count);
        let father = (mother + 1 + rng.below(count - 1)) % count;
        let (a, b) = (rng.below(BITS + 1), rng.below(BITS + 1));
        parents[mother as usize].crossed(parents[father as usize], a.min(b), a.max(b))
    }

    fn mutate(&self, individual: Chromosome, rng: &mut SplitMix64) -> Chromosome {
        match self.config.mutation {
            Mutation::PerIndividual(rate) if rng.chance(rate) => individual.flipped(rng.below(BITS)),
            Mutation::PerIndividual(_) => individual,
            Mutation::PerBit(rate) => {
                (0..BITS).fold(individual, |mutated, bit| if rng.chance(rate) { mutated.flipped(bit) } else { mutated })
            }
        }
    }
}

#[cfg(test)]
#[path = "rmga_tests.rs"]
mod tests;
