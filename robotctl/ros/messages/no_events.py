"""No callbacks for QoS events: rclpy's own ones log from the loop, past the daemon's log queue.

Each event handler also takes a file descriptor, and the graph shows what it would report.
"""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks

NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
NO_SUBSCRIPTION_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
