//! The operator panel of `pb3dp run`.

use std::sync::Arc;

use anyhow::Result;
use nalgebra::Vector3;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::perception::{TargetSource, VisionInput};
use pb3dp_panel::config::Push;
use pb3dp_panel::{About, Panel, PanelConfig};
use pb3dp_setup::setup::Setup;

use crate::logging::show_in_panel;
use crate::panel_access::announce;

/// Starts the panel and makes it the operator of the run: no target is marked until somebody selects one.
///
/// # Errors
/// If the address is in use or is not of this computer, or needs protection.
pub fn start(at: PanelConfig, (setup, name): (&Setup, &str), parts: &mut Parts) -> Result<Panel> {
    let clock = Arc::clone(&parts.clock);
    let config = PanelConfig {
        interrupt: Arc::clone(&parts.interrupt),
        hold_to_run: setup.hold_to_run,
        cameras: parts.camera_controls.clone(),
        log_lines: show_in_panel(Arc::clone(&clock)),
        push: parts.pushed.clone().map(|target| -> Push {
            Arc::new(move |offset_m: [f64; 3], turn_rad| {
                target.push(Vector3::from(offset_m), turn_rad);
                Ok(())
            })
        }),
        ..at
    };
    let stated = parts.links.iter().filter_map(|(name, link)| Some((*name, link.gateway_limits()?)));
    let stated: Vec<_> = stated.collect();
    let about = About::of_setup(setup, name, env!("CARGO_PKG_VERSION")).with_gateways(&stated);
    let (panel, operator, spectator) = Panel::start(config, clock, about)?;
    parts.operator = Box::new(operator);
    parts.spectators.push(Box::new(spectator));
    let selections = panel.selections();
    if matches!(parts.camera, VisionInput::Images(_)) {
        selections.set_target_of_setup(&parts.marking);
        parts.marking = TargetSource::FromOperator;
    }
    parts.selections = Some(selections);
    announce(&panel, "is the operator panel; Ctrl-C ends the run")?;
    Ok(panel)
}
