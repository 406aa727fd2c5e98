"""Trim and respond, zone by zone and step by step, as ASHRAE Guideline 36-2021 puts it (5.1.14, 5.6.8.1, 5.16.2.2)."""


class Zone:
    """A zone without storage: its load is a share of what full flow of the coldest air takes away."""

    def __init__(self, T_zone, coldest):
        self.set_point, self.design_rise = T_zone, T_zone - coldest
        self.over_95 = False

    def count_requests(self, load, T_supply):
        """Cooling requests with this load and supply air."""
        flow = load * self.design_rise / (self.set_point - T_supply)
        temperature = self.set_point if flow <= 1.0 else T_supply + load * self.design_rise
        if flow > 0.95:
            self.over_95 = True
        elif flow <= 0.85:
            self.over_95 = False
        if temperature - self.set_point > 3.0:
            return 3
        if temperature - self.set_point > 2.0:
            return 2
        return int(self.over_95)


def set_points(loads, T_out, *, T_zone, low, high, T_out_min, T_out_max, trim, respond, most, ignored, delay, step):
    """Supply set-point at each step from the start of the fan on: loads and outdoor temperatures of each step."""
    zones = [Zone(T_zone, low) for _ in loads[0]]
    top, supply_set_points = high, []
    for k, (zone_loads, outdoors) in enumerate(zip(loads, T_out, strict=True)):

        def reset_by_outdoors(top, outdoors=outdoors):
            if outdoors <= T_out_min:
                return top
            if outdoors >= T_out_max:
                return low
            return top - (top - low) * (outdoors - T_out_min) / (T_out_max - T_out_min)

        R = sum(zone.count_requests(load, reset_by_outdoors(top)) for zone, load in zip(zones, zone_loads, strict=True))
        if k * step >= delay:
            top += trim
            if R > ignored:
                top -= min((R - ignored) * respond, most)
            top = max(low, min(high, top))
        supply_set_points.append(reset_by_outdoors(top))
    return supply_set_points
