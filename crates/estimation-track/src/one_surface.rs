//! Finds the part of a region that is one surface: a region marked across a depth edge contains two, which may move
//! independently.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::wide::LANES;

use super::judge::FITS_FROM;
use super::kernels::{CHANNELS, ResidualGroup, SampledGroup, SurfaceGroup, ViewGroup};
use super::relief::Relief;
use super::shape::Shape;
use super::surface::Surface;

/// Smallest share of a patch's points that must fit the right image if the patch belongs to a surface. Chosen by hand, not
/// varied. With the rule as a whole about 1 % of the `ok` frames of rectangles across depth edges are wrong, without 463 of
/// 6830.
const FITTING_MIN: f64 = 0.6;
/// Largest ratio of a patch's squared residuals to those of the best-fitting quarter. Chosen by hand, not varied: with
/// less, parts of one surface are left out; with more, parts of another stay.
const NOISE_MAX: f64 = 3.0;
/// Additional tolerance as a share of the patch's texture: a patch at another depth leaves twice the texture. Chosen by
/// hand, not varied: a tenth of that.
const UNEXPLAINED_MAX: f64 = 0.2;
/// Neighbours are one surface if the depth changes by at most this multiple of their lateral distance. Chosen by hand, not
/// varied: 63 degrees.
const STEEPEST: f64 = 2.0;
/// If a smaller share of the points is off the surface, the robust weights handle them. Chosen by hand, not varied: with
/// less, whole targets start twice; with more, small parts of another surface stay.
const BESIDE_MIN: f64 = 0.15;
/// The same limit if a larger part was removed before, so that there are several surfaces. Chosen by hand, not varied:
/// smaller, because another surface is known.
const BESIDE_SEVERAL_MIN: f64 = 0.05;

/// Above this distance of a part's nodes from its plane (root mean square), pixels of disparity, the part is curved. Chosen by hand, not
/// varied: nodes of a plane lie within 0.1 px, and a relief of 10 mm at half a metre is beyond 1 px.
const CURVED_FROM_PX: f64 = 0.5;
/// The same from which a whole target has a relief, so that its frame is that of its visible surface. Chosen by hand, not varied: twice the
/// distance of nodes of a plane.
const RELIEF_FROM_PX: f64 = 0.2;

/// A part of the surface.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Part {
    /// Its plane in the first left camera: inverse depth is `plane . ray`.
    pub(super) plane: Vector3<f64>,
    /// Per node of the relief: whether it belongs to the part.
    pub(super) nodes: Vec<bool>,
    /// Share of the points.
    pub(super) share: f64,
}

/// The first stereo pair at the points of full resolution.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    /// The stored view: the left image.
    pub(super) view: &'a [ViewGroup],
    /// Both images.
    pub(super) sampled: &'a [[SampledGroup; 2]],
    /// Their differences from the view.
    pub(super) residuals: &'a [ResidualGroup],
}

/// Measurements at a node of the relief.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    /// Number of points that both images show, and number of those that fit the right image. A point that is saturated or outside of
    /// an image tells nothing about the surface.
    points: f64,
    fitting: f64,
    /// Squared residuals of the right image over these points, and squared deviations of the left image from the patch mean, all channels,
    /// squared grey levels.
    residual: f64,
    texture: f64,
    /// Position in the first left camera, metres.
    position: Vector3<f64>,
}

impl Node {
    #[allow(clippy::needless_range_loop, reason = "channels index several arrays")]
    fn add(&mut self, group: &SurfaceGroup, view: &ViewGroup, right: &SampledGroup, residual: &ResidualGroup) {
        let shown = group.mask * view.valid * right.valid;
        let points = || (0..LANES).filter(|&i| shown.0[i] > 0.0);
        let count = (points().count() as f64).max(1.0);
        self.points += points().count() as f64;
        self.fitting += points().filter(|&i| residual.weight[1].0[i] >= FITS_FROM).count() as f64;
        for c in 0..CHANNELS {
            let mean = points().map(|i| f64::from(view.value[c].0[i])).sum::<f64>() / count;
            self.texture += points().map(|i| (f64::from(view.value[c].0[i]) - mean).powi(2)).sum::<f64>();
            self.residual += points().map(|i| f64::from(residual.residual[1][c].0[i]).powi(2)).sum::<f64>();
        }
    }

    /// Whether nothing tells that the node is on another surface.
    fn fits(&self, noise: f64) -> bool {
        self.fitting >= FITTING_MIN * self.points
            && self.residual <= NOISE_MAX * noise * self.points + UNEXPLAINED_MAX * self.texture
    }
}

/// The largest part that is one surface; `None` if the whole region is. `of_several`: the region is the remainder of several
/// surfaces.
pub(super) fn largest_part(surface: &Surface, pair: Pair<'_>, of_several: bool) -> Option<Part> {
    let (relief, shape) = (&surface.relief, &surface.shape);
    let nodes = nodes_of(surface, pair);
    let kept = largest(&nodes, shape);
    let sum = |kept_only: bool| -> f64 {
        let of = nodes.iter().zip(&kept).filter(|(_, kept)| **kept || !kept_only);
        of.map(|(node, _)| node.points).sum()
    };
    let of_part = || nodes.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(node, _)| node);
    let plane = plane_through(of_part())?;
    // The steep border of a curved surface fits badly. Without it the next border does, and the plane tilts with each cut.
    let is_curved = lies_off_plane(of_part(), &plane, relief, CURVED_FROM_PX);
    let beside_min = if of_several && !is_curved { BESIDE_SEVERAL_MIN } else { BESIDE_MIN };
    let beside = sum(false) - sum(true);
    let share = sum(true) / sum(false);
    (beside > 0.0 && beside >= beside_min * sum(false)).then_some(Part { plane, nodes: kept, share })
}

/// Whether the surface is curved.
pub(super) fn is_curved(surface: &Surface, pair: Pair<'_>) -> bool {
    lies_off_its_plane(surface, pair, CURVED_FROM_PX)
}

/// Whether the surface has a relief, be it a small one.
pub(super) fn has_relief(surface: &Surface, pair: Pair<'_>) -> bool {
    lies_off_its_plane(surface, pair, RELIEF_FROM_PX)
}

fn lies_off_its_plane(surface: &Surface, pair: Pair<'_>, from_px: f64) -> bool {
    let nodes = nodes_of(surface, pair);
    plane_through(nodes.iter()).is_some_and(|plane| lies_off_plane(nodes.iter(), &plane, &surface.relief, from_px))
}

fn nodes_of(surface: &Surface, Pair { view, sampled, residuals }: Pair<'_>) -> Vec<Node> {
    let Surface { relief, shape, levels, .. } = surface;
    let mut nodes = vec![Node::default(); shape.mean.len()];
    let common = shape.common_plane();
    for (index, (node, ray)) in nodes.iter_mut().zip(shape.rays()).enumerate() {
        let beyond = shape.beyond(index, &common) * relief.inverse_depth_per_px();
        node.position = ray / (surface.plane.dot(ray) + beyond).max(1e-3);
    }
    let groups = levels[0].groups.iter().zip(view).zip(sampled).zip(residuals).zip(relief.node_of_group());
    for ((((group, view), [_, right]), residual), &node) in groups {
        nodes[node].add(group, view, right, residual);
    }
    nodes
}

/// The nodes of the part with the most fitting points.
fn largest(nodes: &[Node], shape: &Shape) -> Vec<bool> {
    let noise = noise(nodes);
    let fits: Vec<bool> = nodes.iter().map(|node| node.fits(noise)).collect();
    let mut part: Vec<usize> = (0..nodes.len()).collect();
    for &(i, j, _) in shape.edges() {
        let (a, b) = (&nodes[i], &nodes[j]);
        if fits[i] && fits[j] && is_one_surface(&a.position, &b.position) {
            let (from, to) = (part[i], part[j]);
            part.iter_mut().filter(|part| **part == from).for_each(|part| *part = to);
        }
    }
    let mut fitting = vec![0.0; nodes.len()];
    (0..nodes.len()).filter(|&i| fits[i]).for_each(|i| fitting[part[i]] += nodes[i].fitting);
    let best = (0..nodes.len()).max_by(|&a, &b| fitting[a].total_cmp(&fitting[b]));
    (0..nodes.len()).map(|i| fits[i] && Some(part[i]) == best).collect()
}

/// Squared residual per point of the best-fitting quarter of the nodes.
fn noise(nodes: &[Node]) -> f64 {
    let mut squares: Vec<f64> = nodes.iter().filter(|n| n.points > 0.0).map(|n| n.residual / n.points).collect();
    squares.sort_unstable_by(f64::total_cmp);
    squares.get(squares.len() / 4).copied().unwrap_or(0.0)
}

/// Whether a surface through both points is not too steep to be compared.
fn is_one_surface(a: &Vector3<f64>, b: &Vector3<f64>) -> bool {
    let sight = (a + b).normalize();
    let way = b - a;
    let deep = way.dot(&sight);
    deep.abs() <= STEEPEST * (way - sight * deep).norm()
}

/// The plane with the least-squares inverse depth.
fn plane_through<'a>(nodes: impl Iterator<Item = &'a Node>) -> Option<Vector3<f64>> {
    let (mut matrix, mut rhs) = (Matrix3::identity() * 1e-9, Vector3::zeros());
    for node in nodes {
        let ray = node.position / node.position.z;
        matrix += ray * ray.transpose() * node.fitting;
        rhs += ray * (node.fitting / node.position.z);
    }
    matrix.cholesky().map(|factor| factor.solve(&rhs))
}

/// Whether nodes lie farther from a plane than this distance in the root mean square, pixels of disparity.
fn lies_off_plane<'a>(
    nodes: impl Iterator<Item = &'a Node>,
    plane: &Vector3<f64>,
    relief: &Relief,
    from_px: f64,
) -> bool {
    let (mut squares, mut weights) = (0.0, 0.0);
    for node in nodes {
        squares += node.fitting * ((1.0 - plane.dot(&node.position)) / node.position.z).powi(2);
        weights += node.fitting;
    }
    squares > weights * (from_px * relief.inverse_depth_per_px()).powi(2)
}

impl Part {
    /// The part's pixels among those of a region, and the subset of them inside the region's `inner` mask that are at least
    /// `border_px` away from other parts.
    pub(super) fn pixels(&self, relief: &Relief, [mask, inner]: &[RegionMask; 2], border_px: u32) -> [RegionMask; 2] {
        let patches = relief.patches_of(&self.nodes);
        let own = RegionMask::from_fn(mask.size(), |x, y| {
            mask.contains(x as i32, y as i32) && patches[relief.patch_at([f64::from(x), f64::from(y)])]
        });
        let eroded = own.erode(border_px);
        let inside = |x: u32, y: u32| inner.contains(x as i32, y as i32) && eroded.contains(x as i32, y as i32);
        let inside = RegionMask::from_fn(mask.size(), inside);
        [own, inside]
    }
}
