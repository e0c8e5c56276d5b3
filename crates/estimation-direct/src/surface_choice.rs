//! Constants that choose the surface of a region, in one place.
//!
//! They are no settings of the program. `bench real --leave-one-scene-out` refits all of them with one scene left out at a time
//! and measures how much worse an unseen scene fares: the values `tried` are those that it compares with the present one.

/// One constant of [`SurfaceChoice`].
#[derive(Clone, Copy, Debug)]
pub struct Constant {
    /// Its name.
    pub name: &'static str,
    /// Other values that a fit compares with its present value.
    pub tried: &'static [f64],
    /// Its value.
    pub get: fn(&SurfaceChoice) -> f64,
    /// Sets it.
    pub set: fn(&mut SurfaceChoice, f64),
}

/// Defines the constants: name, value, and the values that a fit tries.
macro_rules! constants {
    ($($(#[doc = $doc:literal])* $name:ident = $value:literal, tried [$($tried:literal),*];)*) => {
        /// Constants of the choice between candidate surfaces.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct SurfaceChoice {
            $($(#[doc = $doc])* pub $name: f64,)*
        }

        impl Default for SurfaceChoice {
            fn default() -> Self {
                Self { $($name: $value,)* }
            }
        }

        impl SurfaceChoice {
            /// All constants, for programs that fit them.
            pub const ALL: &[Constant] = &[$(Constant {
                name: stringify!($name),
                tried: &[$($tried),*],
                get: |choice| choice.$name,
                set: |choice, value| choice.$name = value,
            },)*];
        }
    };
}

constants! {
    /// Factor by which patches support a plane more than single clear disparities do. Chosen by hand, not varied: with more,
    /// the first search is final for more regions with few clear disparities.
    decided_clear = 1.5, tried [1.2, 2.0];
    /// The search begins on the first level on which the region has at most this many pixels: an eighth of the work of the next (a
    /// quarter of the pixels and half of the disparities of `direct.search.quick_area_max_px`).
    coarse_area_px = 1500.0, tried [900.0, 3000.0];
    /// The search ends there if one plane explains this share of the clear disparities; the share is soft, because noise takes a
    /// tenth or two. A second surface would take more. Chosen with the next two: of 613 real windows and 109 cases none changes its
    /// pass or status by ending there.
    one_plane_share = 0.75, tried [0.65, 0.85];
    /// Smallest share of the region that these disparities must have. Chosen, see [`SurfaceChoice::one_plane_share`].
    one_plane_clear = 0.5, tried [0.35, 0.65];
    /// Smallest share of the textured patches that must support the plane. Chosen, see [`SurfaceChoice::one_plane_share`].
    one_plane_support = 0.8, tried [0.7, 0.9];
    /// Candidates with this share of the best score, on the level where it is lower, are compared again. Chosen by hand, not
    /// varied: each such candidate costs an evaluation on the finest level; with more, the right one may be left out.
    near_score = 0.6, tried [0.45, 0.75];
    /// If this share of the textured patches supports the plane, and `direct.status.support_sure_min` of the region, the region lies on it as
    /// a whole: its outline is at the correct position, so that it is no alias, and no other surface pulls at it. Otherwise the
    /// distance from the plane through the clear disparities counts as error. Chosen, see [`SurfaceChoice::repeats_min`].
    whole_support_min = 0.7, tried [0.6, 0.85];
    /// Smallest share that must agree with a plane, for a confident estimate, of all that says anything of it: the shares of the region
    /// whose patches support it, whose pixels match on it, and whose pixels match elsewhere. Blank parts say nothing. Chosen
    /// with `direct.status.support_sure_min` on 2227 random windows and public cases: with the scene of each left out in the choice,
    /// 1151 right planes pass, and 54 that are off by more than 3 standard deviations; with a limit of the region alone 1095 and 62.
    agreement_min = 0.73, tried [0.67, 0.8];
    /// If this share of the region supports the plane, the rest may be another surface: a rectangle around a target shows the background,
    /// too. Chosen by hand: the limit for all regions before.
    sure_area_min = 0.4, tried [0.35, 0.5];
    /// With less support than this, the region may not be planar. Chosen: of 85 such regions 46 % of true disparities are met, 38 %
    /// without.
    plane_support_min = 0.5, tried [0.4, 0.6];
    /// If the pixels that agree with a plane correlate less than this, noise may be why the others do not agree. Chosen by
    /// hand, not varied: with less, noisy planes count as surfaces that are not planes; with more, such surfaces get a refined
    /// plane.
    plane_correlation_min = 0.8, tried [0.7, 0.9];
    /// Disparities this close to a plane are explained by it, pixels. The criterion of the benchmark of real non-planar regions
    /// (docs/benchmarks/real.md).
    widest_px = 1.0, tried [0.7, 1.4];
    /// Lower bound of this distance, in pixels of the searched level. Chosen by hand, not varied: the same as the default of
    /// `direct.search.tolerance_px`.
    widest_level_px_min = 0.5, tried [0.35, 0.7];
    /// The plane replaces a refined plane that differs by more than this at a corner of the region's box, pixels. Chosen by
    /// hand, not varied: with less, noise replaces refined planes.
    widest_apart_px = 0.5, tried [0.35, 0.7];
    /// Clear disparities represent the region if this share of its pixels has one. With 0.5 one real case across a depth edge is
    /// lost.
    widest_valid_min = 0.6, tried [0.45, 0.75];
    /// Disparities scatter around the plane if half of the tolerance contains less than this share of those within the full
    /// tolerance. Uniformly distributed disparities give one half, those of a plane nearly one. Chosen by hand between these,
    /// not varied.
    spread_near_max = 0.6, tried [0.53, 0.7];
    /// A rival that shares more than this of its pixels with the first surface is another explanation of the same surface. More
    /// than half: most of its pixels are those of the first surface.
    overlap_of_alias = 0.5, tried [0.35, 0.65];
    /// A patch result is valid for another plane that differs by at most this at the corners of the region's box, pixels of the
    /// level: the peak of a correlation is flat. Chosen by hand, not varied: with less, more patches are evaluated twice; the
    /// real cases passed as before when this rule came.
    settled_px = 0.1, tried [0.05, 0.2];
    /// Candidates with at least this share of the best score are nearly as good. Chosen by hand, not varied: each such
    /// candidate costs a second evaluation of its patches.
    nearly_equal = 0.9, tried [0.8, 0.95];
    /// Smallest share of the region that a second surface must have for itself. Chosen by hand, not varied: with less, chance
    /// matches are reported as second surfaces; with more, small surfaces are not reported.
    own_share_min = 0.08, tried [0.05, 0.12];
    /// Pixels of a surface have disparities this close to its plane, pixels of the searched level. Chosen with figures: of 425 windows
    /// across depth edges in 17 real scenes 363 pass, without the comparison of areas 356; without weights of places 366 with 1 px, 363 with 1.5 px.
    on_plane_px = 1.0, tried [0.7, 1.5];
    /// Patches fit a plane closely if they differ from it by clearly less than this, pixels of the level. Chosen by hand, not
    /// varied: with more, a plane across a step of a few pixels is close to both surfaces; with less, noise decides.
    close_px = 0.35, tried [0.25, 0.5];
    /// Drawn planes are first counted with this width, pixels of the level. Chosen by hand, not varied: wider than
    /// [`SurfaceChoice::close_px`], because planes through three patches are less accurate.
    drawn_px = 0.5, tried [0.35, 0.7];
    /// If this share of the patches' weight fits the evaluated plane closely, no other plane is searched. More than half: a
    /// plane through other patches has less.
    closest_decisive_share = 0.5, tried [0.4, 0.65];
    /// Factor by which more weight must fit another plane closely. Chosen by hand, not varied: with less, noise replaces right
    /// planes; with more, planes that bridge a step stay.
    closest_gain_min = 1.15, tried [1.05, 1.3];
    /// Smallest difference of another plane at a corner of the patches' box, pixels of the level. Chosen by hand, not varied:
    /// the refinement corrects smaller differences itself (`jump_max_px`: 1.5).
    closest_apart_px = 1.0, tried [0.7, 1.4];
    /// The comparison runs on the first level on which the region has at most this many pixels. Chosen: with it and
    /// [`SurfaceChoice::decisive_correlation`] 22 of 8064 random real rectangles in wrong ranges are confident and wrong, with 1600 px and without
    /// the latter 42.
    beyond_area_px = 900.0, tried [600.0, 1400.0];
    /// Planes whose disparity at the centroid is at most this far outside the range do not count as beyond it, pixels: a plane
    /// at an end of the range must be distinguishable from one inside it. Chosen by hand, not varied: with less, planes at an
    /// end of the range count as beyond it; with more, a target just outside is missed.
    beyond_end_px = 2.0, tried [1.4, 2.8];
    /// A surface with this score and [`SurfaceChoice::decisive_correlation`] needs no comparison. Chosen: without any, 587 of these 8064 are
    /// confident and wrong.
    decisive_score = 1.2, tried [1.0, 1.4];
    /// Correlation that it needs. Chosen: 81 of 1513 correct estimates in correct ranges lose their `ok`, without it and with 1600
    /// px 71.
    decisive_correlation = 0.9, tried [0.8, 1.0];
    /// Smallest mean correlation of neighbourhoods with those one period away, relative to their correlation with themselves,
    /// for a repeating texture. Chosen by hand, not varied. With the rule as a whole, 7 searches of 11 boards in two wrong
    /// ranges each were wrong and `ok`, without it 15.
    repeats_min = 0.35, tried [0.25, 0.5];
    /// Before the peak, the correlation must have fallen to this share of it: smooth texture is similar to itself nearby.
    /// Chosen by hand, not varied: with more, smooth texture counts as repeating.
    valley_max = 0.5, tried [0.35, 0.7];
    /// Smallest share of the points with a partner in the region. Chosen by hand, not varied: the longest shift, half of a
    /// rectangle, leaves half of the points a partner.
    partners_min = 0.4, tried [0.3, 0.5];
    /// Smallest amount of textured points, in units of a neighbourhood with strong texture. Chosen by hand, not varied: with
    /// less, a few edges decide.
    repeats_textured_min = 40.0, tried [20.0, 80.0];
    /// If the right image does not show some of the searched depths, the agreeing patches must have this correlation: a
    /// self-similar texture correlates less with another part of itself. Chosen by hand, not varied: with less, aliases at the
    /// border of the image are `ok`; with more, right answers become `ambiguous`.
    unseen_correlation_min = 0.75, tried [0.65, 0.85];
    /// An estimate this close to an end of the range gets a warning, pixels: the search covers little beyond the end. Chosen by
    /// hand, not varied: half of the step between searched disparities at full size.
    end_of_range_px = 0.5, tried [0.25, 1.0];
    /// Patches agree with a plane as well as with their own if support times correlation is lower by at most this. Chosen by
    /// hand, not varied: with less, noise of the correlation alone moves the answer half-way to the patch plane.
    agreement_tolerance = 0.005, tried [0.0025, 0.01];
    /// Patches cannot distinguish planes that differ by at most this at the region's border, pixels. Chosen by hand, not
    /// varied: between closer planes, [`SurfaceChoice::patch_sigma_px`] decides alone.
    patch_precision_px = 0.25, tried [0.15, 0.4];
    /// Patches ignore row offsets: with larger row offsets than this they are wrong themselves, pixels. Chosen by hand, not
    /// varied: with more, patches of wrong rows move the answer.
    patch_rows_px = 0.2, tried [0.1, 0.4];
    /// Planes much closer than this at the border of the region, pixels, differ by noise, which moves the patches more than the
    /// refined plane. Fitted on rendered grey and crab targets: errors are 1.01 to 1.08 times those of the refined plane, with half
    /// of it 1.10 to 1.39; of real windows of 28 to 40 px half of it lets 243 of 288 pass, this 241.
    patch_sigma_px = 0.2, tried [0.1, 0.4];
    /// If patches correlate less than this, noise moves them further than the refinement. Chosen by hand, not varied: with
    /// less, noise of the patches moves the answer; with more, fewer answers gain from them.
    clear_correlation_min = 0.9, tried [0.8, 0.95];
    /// Two planes are different surfaces if they differ by more than this at the region's centroid or, on average, at the corners
    /// of its box, pixels of the search level. Chosen by hand, not varied.
    differs_px = 2.0, tried [1.4, 2.8];
    /// The region may be one curved surface if less than this share of its clear disparities is on the refined plane. Chosen with the
    /// next four on rendered shells of 5 to 25 mm and on rectangles over a background: of 182 real cases none changes its pass or status.
    continued_near_max = 0.8, tried [0.7, 0.9];
    /// Largest change of the distance from the plane between neighbours of one surface, pixels of the search level.
    continued_jump_px = 0.75, tried [0.5, 1.0];
    /// The region is one surface if the one that continues the plane has at least this share of the clear disparities, and ...
    continued_share_min = 0.95, tried [0.9, 0.98];
    /// ... at most this many steps between neighbours, per side of the region.
    continued_steps_max = 1.0, tried [0.5, 2.0];
    /// It is curved if its pixels are this far from its plane, rms, pixels of the search level: those of a plane are at 0.2 to 0.3.
    continued_rms_min_px = 0.4, tried [0.3, 0.6];
    /// With more steps it is uncertain whether the region is one surface. If less than this share is on the refined plane, the distance
    /// of the plane of least squares counts as error. Chosen on the same shells: it is 0.1 to 0.3 there, and above 0.4 on rectangles.
    continued_doubt_max = 0.4, tried [0.3, 0.5];
    /// If more of the region than this supports the plane, the region shows that plane and another surface, not one that is curved.
    /// Chosen: rendered shells of 5 to 25 mm with one surface support their plane by at most 0.62, half of them by less than 0.53;
    /// of 849 real windows and cases two planes on folded cloth are right, without it both are `ok` and off by 42 degrees.
    continued_support_max = 0.6, tried [0.5, 0.7];
}
