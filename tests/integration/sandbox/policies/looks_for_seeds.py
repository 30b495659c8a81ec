# expect: harmless
# where: episode
class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = [key for key in observation if key not in {"marker_flow", "relative_motion"}]
        return [float(len(found)), 0.0, 0.0]
